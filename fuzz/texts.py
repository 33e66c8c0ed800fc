"""Texts, numbers and bytes that programs stumble over."""

from __future__ import annotations

NUMBERS = (
    *("0", "-0", "1", "-1", "0.5", "1e-8", "1e-320", "1e150", "1e154", "1e160", "1e308", "1e400"),
    *("nan", "NaN", "inf", "-inf", "0x10", "1_000", "1,5", "１", "+1", ".5", "5.", "1e", "--1"),
    *("9223372036854775807", "9223372036854775808", "-9223372036854775809", "1" + 400 * "0"),
    *("3000000000", "65536", "true", "null", "", " ", "1 2", "'1'", '"1"', "1e1e1"),
)

NAMES = (
    *(
        "",
        " ",
        "a",
        "item",
        "a,b",
        'a"b',
        "a\nb",
        "a\tb",
        "a\0b",
        "\x1b[31mred",
        "café",
        "cafe\u0301",
    ),
    *("\u202e", "\ud800", "../up", "/root", "-", ".", "..", "=1+1", "x" * 3000, "😀", "NaN", "%41"),
    *("{data}", "*", "[a]", "~", "$HOME", "`id`", "#1", "|", "item#2"),
)

YAML_VALUES = (
    *NUMBERS,
    *(
        "[]",
        "{}",
        "[1]",
        "[a, b]",
        "{a: 1}",
        "[[1], 2]",
        "{a: {b: 1}}",
        "~",
        "*a",
        "&a 1",
        "!!int x",
    ),
    *("!!python/object:os.system x", "!!binary aGk=", "2020-01-01", "yes", "no", "off", "|", ">"),
    *(
        "'",
        '"',
        "[",
        "{",
        "- a",
        "? a",
        "<<: {a: 1}",
        "!!set {a}",
        '"\\ud800"',
        '"\\0"',
        "@a",
        "%a",
    ),
    *("/", "/dev/null", "/dev/full", "-", ".", "shapes.h5", "dict.h5", "views.h5", "nowhere.h5"),
    *("'*.h5'", "result.h5", "[views.h5, views.csv]", "views.csv", "{m: result.h5}", "all", "auto"),
    *("[nose, neck, pelvis]", "item", "model", "weight", "true_rotation", "none", "[0.3, 0.2]"),
)
