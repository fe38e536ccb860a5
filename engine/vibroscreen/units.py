"""Conversion factors: a value in the named unit times the factor is the value in SI.

`5.0 * MM` is 0.005 m; a length in metres divided by `MM` is in millimetres.
"""

from __future__ import annotations

import math

__all__ = [
    "CM",
    "DAY",
    "DEG",
    "GRAVITY",
    "G_CM3",
    "HOUR",
    "INCH",
    "KG_H",
    "KN",
    "KW",
    "KWH",
    "KWH_T",
    "MICROMETRE",
    "MINUTE",
    "MM",
    "PERCENT",
    "RPM",
    "TONNE",
    "T_H",
    "T_M3",
]

GRAVITY = 9.81  # m/s2, the value of every equation and reference case of the model

MM = 1e-3  # m
MICROMETRE = 1e-6  # m
CM = 1e-2  # m
INCH = 0.0254  # m
DEG = math.pi / 180.0  # rad
MINUTE = 60.0  # s
HOUR = 3600.0  # s
DAY = 86400.0  # s
RPM = 1.0 / 60.0  # Hz, from 1/min
TONNE = 1000.0  # kg
T_H = 1.0 / 3.6  # kg/s, from t/h
KG_H = 1.0 / 3600.0  # kg/s, from kg/h
T_M3 = 1000.0  # kg/m3, from t/m3
G_CM3 = 1000.0  # kg/m3, from g/cm3
KW = 1000.0  # W
KN = 1000.0  # N
KWH = 3.6e6  # J
KWH_T = 3600.0  # J/kg, from kWh/t
PERCENT = 0.01  # 1
