/**
 * Lines, marks and meshes in WebGL2, seen by an orthographic camera.
 *
 * A camera is {rotation (9 numbers), zoom (px a unit), pan (px), reach (the depth that fades),
 * background}; all points are given around the point that it circles. Colours are [red, green,
 * blue, alpha].
 */
const drawing = (() => {
  const PLACE = `#version 300 es
    precision highp float;
    uniform mat3 rotation; uniform vec2 pan, size; uniform float zoom, reach;
    out vec4 colour; out float far;
    vec4 place(vec3 point) {
      vec3 turned = rotation * point;
      far = clamp(0.5 - 0.5 * turned.z / reach, 0.0, 1.0);
      return vec4((zoom * turned.xy + pan) * 2.0 / size, -0.5 * turned.z / reach, 1.0);
    }`;
  const FADE = `#version 300 es
    precision highp float;
    uniform vec4 background; in vec4 colour; in float far; out vec4 pixel;
    vec4 fade(vec4 c) { return vec4(mix(c.rgb, background.rgb, 0.55 * far * far), c.a); }`;

  /* A line is a strip of four corners, as wide as given, between its projected ends. */
  const LINES = [`${PLACE}
    in vec3 start, end; in vec4 tint; in float width; in vec2 corner;
    void main() {
      vec4 a = place(start); float farA = far; vec4 b = place(end);
      vec2 along = (b.xy - a.xy) * size; float length_ = max(length(along), 1e-6);
      vec2 across = vec2(-along.y, along.x) / length_ * width / size;
      far = mix(farA, far, corner.x); colour = tint;
      gl_Position = mix(a, b, corner.x) + vec4(across * corner.y, 0.0, 0.0);
    }`, `${FADE} void main() { pixel = fade(colour); }`];

  /* Marks are discs (0), rings (1) and crosses (2). */
  const MARKS = [`${PLACE}
    in vec3 point; in vec4 tint; in float diameter, kind; out float shape;
    void main() { gl_Position = place(point); gl_Position.z -= 0.002; gl_PointSize = diameter; colour = tint; shape = kind; }`,
  `${FADE} in float shape;
    void main() {
      vec2 at = 2.0 * gl_PointCoord - 1.0; float distance_ = length(at);
      float cross_ = min(abs(at.x - at.y), abs(at.x + at.y));
      if (shape < 0.5 ? distance_ > 1.0 : shape < 1.5 ? distance_ > 1.0 || distance_ < 0.62 : cross_ > 0.4) discard;
      pixel = fade(colour);
    }`];

  /* Triangles have one normal each, lit from the viewer's upper left. */
  const MESH = [`${PLACE}
    in vec3 point; uniform vec4 only; out vec3 seen;
    void main() { gl_Position = place(point); seen = rotation * point; colour = only; }`,
  `${FADE} in vec3 seen;
    void main() {
      vec3 normal = normalize(cross(dFdx(seen), dFdy(seen)));
      float light = 0.45 + 0.55 * abs(dot(normal, normalize(vec3(-0.3, 0.5, 0.8))));
      pixel = vec4(fade(colour).rgb * light, colour.a);
    }`];

  const STRIDES = { start: 3, end: 3, point: 3, tint: 4, width: 1, diameter: 1, kind: 1, corner: 2 };
  const CORNERS = [0, -1, 0, 1, 1, -1, 1, 1];

  function program(gl, [vertex, fragment]) {
    const made = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    return made;
  }

  /** What draws on a canvas; null where the browser has no WebGL2. */
  function renderer(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
    if (!gl) return null;
    const programs = { lines: program(gl, LINES), marks: program(gl, MARKS), mesh: program(gl, MESH) };
    const buffers = {};
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);

    /** Use a program with the uniforms of all programs, draw, and let go of its attributes. */
    function run(made, camera, attributes, draw) {
      gl.useProgram(made);
      const at = (name) => gl.getUniformLocation(made, name);
      gl.uniformMatrix3fv(at("rotation"), true, camera.rotation);
      gl.uniform2f(at("pan"), camera.pan[0], -camera.pan[1]);
      gl.uniform2f(at("size"), canvas.clientWidth, canvas.clientHeight);
      gl.uniform1f(at("zoom"), camera.zoom);
      gl.uniform1f(at("reach"), camera.reach);
      gl.uniform4fv(at("background"), camera.background);
      const used = Object.entries(attributes).map(([name, values]) => {
        const place = gl.getAttribLocation(made, name);
        buffers[name] ??= gl.createBuffer();
        gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
        gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.DYNAMIC_DRAW);
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, STRIDES[name], gl.FLOAT, false, 0, 0);
        gl.vertexAttribDivisor(place, attributes.corner && name !== "corner" ? 1 : 0);
        return place;
      });
      draw(at);
      for (const place of used) gl.disableVertexAttribArray(place);
    }

    function clear(background) {
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(...background);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    }

    /** Draw lines [{start, end, tint, width}]. */
    function lines(camera, list) {
      const flat = (name) => list.flatMap((line) => line[name]);
      const attributes = { start: flat("start"), end: flat("end"), tint: flat("tint"), width: flat("width"), corner: CORNERS };
      run(programs.lines, camera, attributes, () => gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, list.length));
    }

    /** Draw marks [{point, tint, diameter, kind}]. */
    function marks(camera, list) {
      const ratio = canvas.width / canvas.clientWidth;
      const flat = (name) => list.flatMap((mark) => mark[name]);
      const attributes = { point: flat("point"), tint: flat("tint"), diameter: flat("diameter").map((d) => d * ratio), kind: flat("kind") };
      run(programs.marks, camera, attributes, () => gl.drawArrays(gl.POINTS, 0, list.length));
    }

    /** Draw triangles, three points each (9 numbers); what is pale does not hide. */
    function mesh(camera, triangles, tint) {
      run(programs.mesh, camera, { point: triangles }, (at) => {
        gl.uniform4fv(at("only"), tint);
        gl.depthMask(tint[3] === 1);
        gl.drawArrays(gl.TRIANGLES, 0, triangles.length / 3);
        gl.depthMask(true);
      });
    }

    return { clear, lines, marks, mesh };
  }

  return { renderer, DISC: 0, RING: 1, CROSS: 2 };
})();
