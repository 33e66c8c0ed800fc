"""Eighteen cars of six kinds, by their dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from sample_data.car_body import Dimensions

_SEDAN = Dimensions(
    length=4.65, width=1.82, height=1.45, wheelbase=2.75, front_overhang=0.88, clearance=0.20,
    wheel_radius=0.32, hood_front=0.74, to_cowl=1.42, cowl=0.98, to_roof=2.12,
    to_b_pillar=2.52, to_c_pillar=3.22, to_roof_rear=3.48, roof_drop=0.09, to_deck=4.08,
    deck=1.06, tail=1.00, belt_front=0.90, belt_rear=0.97,
)  # fmt: skip
_HATCHBACK = Dimensions(
    length=4.05, width=1.75, height=1.47, wheelbase=2.55, front_overhang=0.80, clearance=0.20,
    wheel_radius=0.31, hood_front=0.76, to_cowl=1.18, cowl=1.00, to_roof=1.88,
    to_b_pillar=2.28, to_c_pillar=3.00, to_roof_rear=3.50, roof_drop=0.10, to_deck=3.84,
    deck=1.06, tail=1.00, belt_front=0.92, belt_rear=1.00, tail_rake=0.6,
)  # fmt: skip
_ESTATE = Dimensions(
    length=4.70, width=1.82, height=1.48, wheelbase=2.75, front_overhang=0.88, clearance=0.20,
    wheel_radius=0.32, hood_front=0.74, to_cowl=1.42, cowl=0.98, to_roof=2.12,
    to_b_pillar=2.52, to_c_pillar=3.30, to_roof_rear=4.22, roof_drop=0.07, to_deck=4.50,
    deck=1.04, tail=0.98, belt_front=0.90, belt_rear=0.97, tail_rake=0.5, quarter_glass=True,
)  # fmt: skip
_SUV = Dimensions(
    length=4.60, width=1.88, height=1.72, wheelbase=2.70, front_overhang=0.90, clearance=0.28,
    wheel_radius=0.37, hood_front=0.95, to_cowl=1.38, cowl=1.16, to_roof=2.00,
    to_b_pillar=2.46, to_c_pillar=3.22, to_roof_rear=4.15, roof_drop=0.07, to_deck=4.42,
    deck=1.18, tail=1.10, belt_front=1.08, belt_rear=1.14, lean_in=0.24, nose_rake=0.7,
    tail_rake=0.4, quarter_glass=True,
)  # fmt: skip
_PICKUP = Dimensions(
    length=5.30, width=1.90, height=1.80, wheelbase=3.12, front_overhang=0.92, clearance=0.32,
    wheel_radius=0.39, hood_front=1.02, to_cowl=1.50, cowl=1.20, to_roof=2.05,
    to_b_pillar=2.55, to_c_pillar=3.26, to_roof_rear=3.50, roof_drop=0.04, to_deck=3.66,
    deck=1.16, tail=1.14, belt_front=1.12, belt_rear=1.12, lean_in=0.22, nose_rake=0.5,
    tail_rake=0.1, bed=0.36,
)  # fmt: skip
_VAN = Dimensions(
    length=4.90, width=1.92, height=1.95, wheelbase=3.05, front_overhang=0.95, clearance=0.22,
    wheel_radius=0.34, hood_front=0.92, to_cowl=1.02, cowl=1.18, to_roof=1.80,
    to_b_pillar=2.22, to_c_pillar=3.22, to_roof_rear=4.62, roof_drop=0.04, to_deck=4.74,
    deck=1.16, tail=1.08, belt_front=1.08, belt_rear=1.10, lean_in=0.15, nose_rake=0.8,
    tail_rake=0.2, quarter_glass=True,
)  # fmt: skip

MODELS: Mapping[str, Dimensions] = {
    "sedan_1": _SEDAN,
    "sedan_2": replace(  # small, short trunk
        _SEDAN, length=4.38, width=1.74, height=1.47, wheelbase=2.60, front_overhang=0.84,
        to_cowl=1.26, to_roof=1.98, to_b_pillar=2.38, to_c_pillar=3.08, to_roof_rear=3.32,
        to_deck=3.90, hood_front=0.78, cowl=1.00, deck=1.10, tail=1.05, belt_rear=1.00,
        lean_in=0.24,
    ),
    "sedan_3": replace(  # long, low, upright rear window
        _SEDAN, length=5.05, width=1.89, height=1.46, wheelbase=3.02, front_overhang=0.90,
        wheel_radius=0.34, to_cowl=1.62, to_roof=2.30, to_b_pillar=2.74, to_c_pillar=3.58,
        to_roof_rear=3.84, to_deck=4.34, roof_drop=0.06, hood_front=0.72, tail=1.02, deck=1.04,
    ),
    "sedan_4": replace(  # fastback
        _SEDAN, length=4.72, width=1.86, height=1.39, wheelbase=2.84, front_overhang=0.86,
        clearance=0.17, wheel_radius=0.335, hood_front=0.66, to_cowl=1.50, cowl=0.90,
        to_roof=2.34, to_b_pillar=2.66, to_c_pillar=3.22, to_roof_rear=3.44, roof_drop=0.10,
        to_deck=4.38, deck=1.00, tail=0.98, belt_front=0.85, belt_rear=0.96, lean_in=0.36,
        nose_rake=1.2,
    ),
    "hatchback_1": _HATCHBACK,
    "hatchback_2": replace(  # city car
        _HATCHBACK, length=3.58, width=1.64, height=1.50, wheelbase=2.36, front_overhang=0.68,
        wheel_radius=0.28, to_cowl=0.96, cowl=1.02, to_roof=1.56, to_b_pillar=1.96,
        to_c_pillar=2.66, to_roof_rear=3.14, to_deck=3.42, belt_rear=1.04, deck=1.10, tail=1.00,
        tail_rake=0.3, hood_front=0.80,
    ),
    "hatchback_3": replace(  # compact, fast tail
        _HATCHBACK, length=4.30, width=1.80, height=1.45, wheelbase=2.64, front_overhang=0.86,
        wheel_radius=0.32, to_cowl=1.32, cowl=0.98, to_roof=2.06, to_b_pillar=2.46,
        to_c_pillar=3.16, to_roof_rear=3.56, to_deck=4.06, roof_drop=0.12, hood_front=0.72,
        belt_front=0.90, belt_rear=1.00, lean_in=0.32,
    ),
    "hatchback_4": replace(  # tall, one volume
        _HATCHBACK, length=4.12, width=1.74, height=1.60, wheelbase=2.58, front_overhang=0.82,
        to_cowl=1.00, cowl=1.06, to_roof=1.86, to_b_pillar=2.26, to_c_pillar=3.04,
        to_roof_rear=3.66, roof_drop=0.08, to_deck=3.92, belt_front=0.98, belt_rear=1.06,
        deck=1.12, tail=1.04, hood_front=0.84, lean_in=0.22,
    ),
    "estate_1": _ESTATE,
    "estate_2": replace(  # long and square
        _ESTATE, length=4.92, width=1.86, height=1.50, wheelbase=2.88, front_overhang=0.92,
        to_cowl=1.52, to_roof=2.18, to_b_pillar=2.60, to_c_pillar=3.42, to_roof_rear=4.58,
        to_deck=4.76, roof_drop=0.03, tail_rake=0.2, hood_front=0.78, cowl=1.00, lean_in=0.22,
    ),
    "estate_3": replace(  # small, sloping tail
        _ESTATE, length=4.45, width=1.77, height=1.46, wheelbase=2.62, front_overhang=0.86,
        wheel_radius=0.31, to_cowl=1.30, to_roof=2.04, to_b_pillar=2.42, to_c_pillar=3.12,
        to_roof_rear=3.84, to_deck=4.22, roof_drop=0.12, belt_rear=1.01, deck=1.08,
    ),
    "suv_1": _SUV,
    "suv_2": replace(  # off-roader, all edges
        _SUV, length=4.40, width=1.84, height=1.86, wheelbase=2.60, front_overhang=0.82,
        clearance=0.34, wheel_radius=0.40, hood_front=1.10, to_cowl=1.46, cowl=1.22,
        to_roof=1.86, to_b_pillar=2.34, to_c_pillar=3.10, to_roof_rear=4.16, to_deck=4.26,
        deck=1.26, tail=1.18, belt_front=1.16, belt_rear=1.20, lean_in=0.14, nose_rake=0.2,
        tail_rake=0.1, roof_drop=0.02,
    ),
    "suv_3": replace(  # large, sloping roof
        _SUV, length=4.95, width=1.98, height=1.76, wheelbase=2.95, front_overhang=0.94,
        wheel_radius=0.39, to_cowl=1.50, to_roof=2.24, to_b_pillar=2.70, to_c_pillar=3.52,
        to_roof_rear=4.26, to_deck=4.70, roof_drop=0.14, cowl=1.14, belt_rear=1.20, deck=1.22,
        tail=1.16, lean_in=0.30,
    ),
    "pickup_1": _PICKUP,
    "pickup_2": replace(  # smaller and lower
        _PICKUP, length=4.95, width=1.80, height=1.68, wheelbase=2.95, front_overhang=0.86,
        clearance=0.27, wheel_radius=0.35, hood_front=0.90, to_cowl=1.36, cowl=1.08,
        to_roof=1.96, to_b_pillar=2.42, to_c_pillar=3.02, to_roof_rear=3.22, to_deck=3.42,
        deck=1.06, tail=1.04, belt_front=1.00, belt_rear=1.02, lean_in=0.26, bed=0.32,
        nose_rake=0.8,
    ),
    "van_1": _VAN,
    "van_2": replace(  # small delivery van without rear windows
        _VAN, length=4.40, width=1.80, height=1.84, wheelbase=2.72, front_overhang=0.88,
        wheel_radius=0.32, to_cowl=1.06, cowl=1.10, to_roof=1.72, to_b_pillar=2.12,
        to_c_pillar=2.92, to_roof_rear=4.12, to_deck=4.24, hood_front=0.86, belt_front=1.00,
        belt_rear=1.02, deck=1.10, tail=1.00, lean_in=0.12, rear_glass=False, quarter_glass=False,
    ),
}  # fmt: skip
