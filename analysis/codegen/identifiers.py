"""Identifiers that Python and C99 both allow."""

import builtins
import keyword
import re

_C = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while _Bool _Complex
_Imaginary asm typeof linux unix main bool true false complex imaginary class new delete this template public private
NULL NAN INFINITY HUGE_VAL HUGE_VALF HUGE_VALL FP_NAN FP_INFINITE FP_ZERO FP_SUBNORMAL FP_NORMAL FP_ILOGB0 FP_ILOGBNAN
FP_FAST_FMA FP_FAST_FMAF FP_FAST_FMAL MATH_ERRNO MATH_ERREXCEPT math_errhandling double_t float_t errno
acos asin atan atan2 cos sin tan acosh asinh atanh cosh sinh tanh exp exp2 expm1 frexp ilogb ldexp log log10 log1p log2
logb modf scalbn scalbln cbrt fabs hypot pow sqrt erf erfc lgamma tgamma gamma ceil floor nearbyint rint lrint llrint
round lround llround trunc fmod remainder remquo copysign nan nextafter nexttoward fdim fmax fmin fma j0 j1 jn y0 y1 yn
fpclassify isfinite isinf isnan isnormal signbit isgreater isgreaterequal isless islessequal islessgreater isunordered
abs labs llabs index signgam drem significand pow10 scalb finite
"""

_OURS = "self u s r step init math period inf"

_HELPERS = """
sgsqrt sgsquare unrooted loaded divide root square power exponential logarithm signum kept low_pass velocity at_least
"""

HELPERS = frozenset(_HELPERS.split())
"""Functions of the generated code."""

RESERVED = frozenset(
    {*_C.split(), *(f"{name}{suffix}" for name in _C.split() for suffix in "fl"), *_OURS.split(), *HELPERS}
)
"""No name of the model may be one of these in generated code: C's words, its library with the float and long double
functions, macros, and what the code itself uses."""


class Names:
    """Identifiers of one generated file: valid in Python and C99, each given once."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def fresh(self, wanted: str) -> str:
        """`wanted`, with underscores added if it is a word of a language or taken."""
        name = wanted
        while name in RESERVED or name in self._taken or keyword.iskeyword(name) or hasattr(builtins, name):
            name += "_"
        self._taken.add(name)
        return name


def words_in(text: str) -> set[str]:
    """The identifiers in a line of generated text."""
    return set(re.findall(r"[A-Za-z_]\w*", text))


def class_name(name: str) -> str:
    """The Python class of a program: uds_t02 becomes Uds4T02."""
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))


def file_scope(name: str) -> list[str]:
    """What a program of this name defines in Python or C."""
    return [class_name(name), f"{name.upper()}_H", *(f"{name}_{what}" for what in ("input", "state", "init", "step"))]
