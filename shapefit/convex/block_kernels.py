"""Kernels over the 2x3 blocks of all atoms, in closed form (see spectral_norm.py).

Blocks lie as six rows (6, k), entry (a, b) in row 3 a + b, so that loops over atoms vectorise;
`planes` (3, q, k) holds B with the atoms innermost, `atoms` (k, 3, q) with them outermost.
"""

from __future__ import annotations

import numpy as np

from shapefit.convex.kernel import kernel


@kernel
def correlate(Y, planes, N):
    """N_i = Y B_i^T for all atoms; Y (2, q), N (6, k).

    Four landmarks a pass: fewer loads and stores of N than one at a time.
    """
    q, k = planes.shape[1], planes.shape[2]
    for b in range(3):
        first, second = N[b], N[3 + b]
        for i in range(k):
            first[i] = 0.0
            second[i] = 0.0
        j = 0
        while j + 4 <= q:
            x0, x1, x2, x3 = Y[0, j], Y[0, j + 1], Y[0, j + 2], Y[0, j + 3]
            y0, y1, y2, y3 = Y[1, j], Y[1, j + 1], Y[1, j + 2], Y[1, j + 3]
            b0, b1, b2, b3 = planes[b, j], planes[b, j + 1], planes[b, j + 2], planes[b, j + 3]
            for i in range(k):
                first[i] += x0 * b0[i] + x1 * b1[i] + x2 * b2[i] + x3 * b3[i]
                second[i] += y0 * b0[i] + y1 * b1[i] + y2 * b2[i] + y3 * b3[i]
            j += 4
        while j < q:
            x0, y0, b0 = Y[0, j], Y[1, j], planes[b, j]
            for i in range(k):
                first[i] += x0 * b0[i]
                second[i] += y0 * b0[i]
            j += 1


@kernel
def largest_nuclear_norm(N):
    """max_i ||N_i||_*; N (6, k)."""
    r0, r1, r2, r3, r4, r5 = N[0], N[1], N[2], N[3], N[4], N[5]
    largest = 0.0
    for i in range(N.shape[1]):
        x0, x1, x2, y0, y1, y2 = r0[i], r1[i], r2[i], r3[i], r4[i], r5[i]
        c0, c1, c2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
        product = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
        trace = x0 * x0 + x1 * x1 + x2 * x2 + y0 * y0 + y1 * y1 + y2 * y2
        largest = max(largest, trace + 2.0 * product)
    return np.sqrt(largest)


@kernel
def moreau(M, N, step, dN, sigma, t, total):
    """sum_i ||prox_t(M_i + sigma (N_i + step dN_i))||_F^2, and s1 + s2 of every argument.

    M, N, dN (6, k); total (k,) is written: atom i is active where total[i] > t.
    """
    m0, m1, m2, m3, m4, m5 = M[0], M[1], M[2], M[3], M[4], M[5]
    n0, n1, n2, n3, n4, n5 = N[0], N[1], N[2], N[3], N[4], N[5]
    d0, d1, d2, d3, d4, d5 = dN[0], dN[1], dN[2], dN[3], dN[4], dN[5]
    value = 0.0
    for i in range(M.shape[1]):
        x0 = m0[i] + sigma * (n0[i] + step * d0[i])
        x1 = m1[i] + sigma * (n1[i] + step * d1[i])
        x2 = m2[i] + sigma * (n2[i] + step * d2[i])
        y0 = m3[i] + sigma * (n3[i] + step * d3[i])
        y1 = m4[i] + sigma * (n4[i] + step * d4[i])
        y2 = m5[i] + sigma * (n5[i] + step * d5[i])
        c0, c1, c2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
        A = x0 * x0 + x1 * x1 + x2 * x2
        C = y0 * y0 + y1 * y1 + y2 * y2
        D = x0 * y0 + x1 * y1 + x2 * y2
        plus = np.sqrt(A + C + 2.0 * np.sqrt(c0 * c0 + c1 * c1 + c2 * c2))
        minus = np.sqrt((A - C) * (A - C) + 4.0 * D * D) / max(plus, 1e-300)
        total[i] = plus
        excess = max(plus - t, 0.0)
        first, second = 0.5 * (plus + minus) - t, 0.5 * (plus - minus)
        value += 0.5 * excess * excess if minus <= t else first * first + second * second
    return value


@kernel
def prox_block(q, t, out):
    """out = prox_t(q) for one block (6,) with s1 + s2 > t; returns the norm of the result."""
    x0, x1, x2, y0, y1, y2 = q[0], q[1], q[2], q[3], q[4], q[5]
    A = x0 * x0 + x1 * x1 + x2 * x2
    C = y0 * y0 + y1 * y1 + y2 * y2
    D = x0 * y0 + x1 * y1 + x2 * y2
    c0, c1, c2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    product = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
    plus = np.sqrt(A + C + 2.0 * product)
    minus = np.sqrt((A - C) * (A - C) + 4.0 * D * D) / plus
    if minus <= t and product > 1e-16 * plus * plus:  # else of rank one up to rounding
        norm = 0.5 * (plus - t)
        f = norm / (plus * product)
        for b in range(3):
            out[b] = f * ((C + product) * q[b] - D * q[3 + b])
            out[3 + b] = f * ((A + product) * q[3 + b] - D * q[b])
        return norm
    s1 = 0.5 * (plus + minus)
    low = (product / s1) ** 2
    f = t / (s1 * plus * minus)
    for b in range(3):
        out[b] = q[b] - f * ((A - low) * q[b] + D * q[3 + b])
        out[3 + b] = q[3 + b] - f * (D * q[b] + (C - low) * q[3 + b])
    return s1 - t


@kernel
def jacobian_rows(q, t, sigma, B, F, count):
    """Append the rows f with sum f^T f = sigma B_i^T (D prox_t)(q) B_i; returns the new count.

    With q = U diag(s) V^T and prox_t(q) = U diag(f) V^T the derivative acts on X = U^T dq V:
    the symmetric part of (X12, X21) is scaled by (f1 - f2) / (s1 - s2), the antisymmetric one by
    (f1 + f2) / (s1 + s2), X_a3 by f_a / s_a, and the diagonal by the prox of the l_inf norm:
    four rows where f1 = f2, six elsewhere. B (3, n) is one atom, F (rows, 2 n).
    """
    x0, x1, x2, y0, y1, y2 = q[0], q[1], q[2], q[3], q[4], q[5]
    A = x0 * x0 + x1 * x1 + x2 * x2
    C = y0 * y0 + y1 * y1 + y2 * y2
    D = x0 * y0 + x1 * y1 + x2 * y2
    c0, c1, c2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    product = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
    plus = np.sqrt(A + C + 2.0 * product)
    minus = np.sqrt((A - C) * (A - C) + 4.0 * D * D) / plus
    s1 = 0.5 * (plus + minus)
    s2 = product / s1
    # u1 = (c, s), u2 = (-s, c): eigenvectors of [[A, D], [D, C]]
    half = 0.5 * (A - C)
    radius = np.sqrt(half * half + D * D)
    c, s = 1.0, 0.0
    if radius > 0.0:
        c, s = (half + radius, D) if half >= 0.0 else (D, radius - half)
        length = np.sqrt(c * c + s * s)
        c /= length
        s /= length
    v0, v1, v2 = c * x0 + s * y0, c * x1 + s * y1, c * x2 + s * y2
    length = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    v0, v1, v2 = v0 / length, v1 / length, v2 / length
    w0, w1, w2 = c * y0 - s * x0, c * y1 - s * x1, c * y2 - s * x2
    along = w0 * v0 + w1 * v1 + w2 * v2
    w0, w1, w2 = w0 - along * v0, w1 - along * v1, w2 - along * v2
    length = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    if length <= 1e-14 * s1:  # rank one: any direction orthogonal to v serves
        w0, w1, w2 = (0.0, -v2, v1) if abs(v0) < 0.7 else (-v1, v0, 0.0)
        length = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    w0, w1, w2 = w0 / length, w1 / length, w2 / length
    z0, z1, z2 = v1 * w2 - v2 * w1, v2 * w0 - v0 * w2, v0 * w1 - v1 * w0

    equal = minus <= t
    norm = max(0.5 * (plus - t), 0.0) if equal else s1 - t  # rounding may undercut t
    diagonal = np.sqrt(0.5 * sigma)
    skew = np.sqrt(0.5 * sigma * ((2.0 * norm if equal else plus - t) / plus))
    out1 = np.sqrt(sigma * norm / s1)
    out2 = np.sqrt(sigma) if not equal else (np.sqrt(sigma * norm / s2) if s2 > 0.0 else 0.0)

    n = B.shape[1]
    B0, B1, B2 = B[0], B[1], B[2]
    top0, top1, top2, top3 = F[count, :n], F[count + 1, :n], F[count + 2, :n], F[count + 3, :n]
    low0, low1, low2, low3 = F[count, n:], F[count + 1, n:], F[count + 2, n:], F[count + 3, n:]
    dc, ds, kc, ks = diagonal * c, diagonal * s, skew * c, skew * s
    for j in range(n):
        b0, b1, b2 = B0[j], B1[j], B2[j]
        e1 = v0 * b0 + v1 * b1 + v2 * b2
        e2 = w0 * b0 + w1 * b1 + w2 * b2
        e3 = z0 * b0 + z1 * b1 + z2 * b2
        top0[j] = dc * e1 - ds * e2
        low0[j] = ds * e1 + dc * e2
        top1[j] = kc * e2 + ks * e1
        low1[j] = ks * e2 - kc * e1
        top2[j] = out1 * c * e3
        low2[j] = out1 * s * e3
        top3[j] = -out2 * s * e3
        low3[j] = out2 * c * e3
    if equal:
        return count + 4
    # (s1 - t - s2) / (s1 - s2)
    symmetric = np.sqrt(0.5 * sigma * ((minus - t) / minus))
    F4, F5 = F[count + 4], F[count + 5]
    for j in range(n):
        b0, b1, b2 = B0[j], B1[j], B2[j]
        e1 = v0 * b0 + v1 * b1 + v2 * b2
        e2 = w0 * b0 + w1 * b1 + w2 * b2
        F4[j] = dc * e1 + ds * e2
        F4[n + j] = ds * e1 - dc * e2
        F5[j] = symmetric * (c * e2 - s * e1)
        F5[n + j] = symmetric * (s * e2 + c * e1)
    return count + 6
