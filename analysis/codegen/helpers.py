"""The few functions that generated code calls, in both languages; each is written out only where it is used."""

from collections.abc import Iterable
from dataclasses import dataclass

from faultline.analysis.codegen.identifiers import words_in


@dataclass(frozen=True)
class Helper:
    """A function: what it does, its body in Python, its C parameters and its C statements."""

    note: str
    arguments: tuple[str, ...]
    python: tuple[str, ...]
    c99: str


FUNCTIONS = {
    "sgsqrt": Helper("sign(d) sqrt(|d|)", ("d",), ("return copysign(sqrt(fabs(d)), d)",), "copysign(sqrt(fabs(d)), d)"),
    "sgsquare": Helper("the inverse of sgsqrt", ("v",), ("return v*fabs(v)",), "v*fabs(v)"),
    "unrooted": Helper(
        "the x with sqrt(x) = v; no number has a negative root",
        ("v",),
        ("return v*v if v >= 0.0 else nan",),
        "v >= 0.0 ? v*v : NAN",
    ),
    "loaded": Helper(
        "the v with v |v| + z v = d, z > 0",
        ("d", "z"),
        ("return copysign(2.0*fabs(d)/(z + sqrt(z*z + 4.0*fabs(d))), d)",),
        "copysign(2.0*fabs(d)/(z + sqrt(z*z + 4.0*fabs(d))), d)",
    ),
    "divide": Helper(
        "a/b, infinite or NaN where b is zero",
        ("a", "b"),
        (
            "if b != 0.0:",
            "    return a/b",
            "return nan if a == 0.0 or a != a else copysign(inf, a)*copysign(1.0, b)",
        ),
        "a/b",
    ),
    "root": Helper(
        "the square root, NaN of a negative number", ("a",), ("return sqrt(a) if a >= 0.0 else nan",), "sqrt(a)"
    ),
    "square": Helper("the square", ("a",), ("return a*a",), "a*a"),
    "power": Helper(
        "a to the power of n > 0, infinite or NaN where that is no number",
        ("a", "n"),
        (
            "try:",
            "    return pow(a, n)",
            "except ValueError:",
            "    return nan",
            "except OverflowError:",
            "    return copysign(inf, a) if n % 2.0 == 1.0 else inf",
        ),
        "pow(a, n)",
    ),
    "exponential": Helper(
        "the exponential, infinite where it is too large",
        ("a",),
        ("return inf if a > 709.7 else exp(a)",),
        "a > 709.7 ? INFINITY : exp(a)",
    ),
    "logarithm": Helper(
        "the natural logarithm, NaN of a negative number",
        ("a",),
        ("if a > 0.0:", "    return log(a)", "return -inf if a == 0.0 else nan"),
        "log(a)",
    ),
    "signum": Helper("the sign", ("a",), ("return float((a > 0.0) - (a < 0.0))",), "(a > 0.0) - (a < 0.0)"),
    "kept": Helper(
        "a state, or where it starts if it is not known",
        ("x", "start"),
        ("return x if isfinite(x) else start",),
        "isfinite(x) ? x : start",
    ),
    "low_pass": Helper(
        "first-order low-pass; it starts with the first value",
        ("old", "value", "share"),
        ("return old + share*(value - old) if isfinite(old) else value",),
        "isfinite(old) ? old + share*(value - old) : value",
    ),
    "at_least": Helper(
        "the larger one, NaN if x is", ("x", "low"), ("return low if x < low else x",), "x < low ? low : x"
    ),
    "velocity": Helper(
        "|v| of an orifice with chord g, solved against its Thevenin equivalent; z is its impedance in the network",
        ("d", "g", "z"),
        (
            "share = at_least(1.0 - g*z, 1e-12)",
            "z0 = z/share",
            "size = fabs(d/share)",
            "return 2.0*size/at_least(z0 + sqrt(z0*z0 + 4.0*size), 1e-12)",
        ),
        "",
    ),
}
"""In an order in which each uses only those before it."""

LIBRARY = ("copysign", "exp", "fabs", "isfinite", "log", "pow", "sqrt", "tanh")
"""What `math` has in Python and `math.h` in C."""


def helpers_in(texts: Iterable[str]) -> dict[str, Helper]:
    """The helpers that these texts call, and those that they call themselves."""
    words = set().union(*map(words_in, texts))
    for name, helper in reversed(FUNCTIONS.items()):
        if name in words:
            words |= words_in("\n".join(helper.python))
    return {name: helper for name, helper in FUNCTIONS.items() if name in words}
