"""The operations of the graph: adding one is one row here.

Folding, intervals, simplification and every target read what they need of an operation from its
row. A kernel also knows rows that no arithmetic stands behind: ``loop`` and ``after`` (see
`inner_loop`), ``sum`` and ``all_finite`` of any number of arguments.
"""

import math
import operator
from collections.abc import Callable

from jaxstage.compiler.ir import arithmetic, intervals, simplify
from jaxstage.compiler.ir.intervals import between, never, of_negative, unless_finite
from jaxstage.compiler.ir.operation import C99, Cxx, IntervalRule, NanRule, Op, always, unbounded

NUMBERS, INTEGERS, BITS, ANY = "fiul", "iul", "iulb", "fiulb"


def _comparison(name: str, sign: str, value: Callable[..., bool], truths: str = "") -> Op:
    """A comparison: false of NaN, but for ``ne``."""
    mirrored = {"gt": "lt", "ge": "le"}.get(name)
    rule = simplify.flipped(mirrored) if mirrored else simplify.comparison(name)
    return Op(
        name=name,
        arity=2,
        takes=ANY,
        gives="b",
        real=value,
        whole=value,
        rewrite=rule,
        c99=C99(infix=sign),
        cxx=Cxx(f"{name}({{}}, {{}})", truth=truths),
    )


def _function(
    name: str,
    vectors: str,
    value: Callable[[float], float] | None,
    interval: IntervalRule = unbounded,
    nan: NanRule = always,
    c99: C99 | None = None,
) -> Op:
    """A function of one real. vectors: its name in C++; in C it is that of ``math.h``."""
    text = C99(library=name) if c99 is None else c99
    cxx = Cxx(f"{vectors}({{}})") if vectors else None
    return Op(name=name, arity=1, real=value, interval=interval, nan=nan, c99=text, cxx=cxx)


_LEAVES = (
    Op(name="const", arity=0, takes="", gives="?", primitive=False),
    Op(name="in", arity=0, takes="", gives="?", primitive=False),
    Op(name="load", arity=1, takes=INTEGERS, gives="?", primitive=False),
    Op(name="loop", arity=None, takes=ANY, gives="?", primitive=False),
    Op(name="after", arity=1, takes="f", gives="?", primitive=False),
    Op(name="sum", arity=None, primitive=False),
    Op(name="all_finite", arity=None, gives="b", primitive=False),
)

_ARITHMETIC = (
    Op(
        name="add",
        arity=2,
        takes=NUMBERS,
        wraps=True,
        real=operator.add,
        whole=operator.add,
        interval=intervals.add,
        nan=unless_finite,
        rewrite=simplify.add,
        c99=C99(infix="+", whole="(T)((U)a + (U)b)"),
        cxx=Cxx("{} + {}"),
    ),
    Op(
        name="sub",
        arity=2,
        takes=NUMBERS,
        wraps=True,
        real=operator.sub,
        whole=operator.sub,
        interval=intervals.sub,
        nan=unless_finite,
        rewrite=simplify.sub,
        c99=C99(infix="-", whole="(T)((U)a - (U)b)"),
        cxx=Cxx("{} - {}"),
    ),
    Op(
        name="mul",
        arity=2,
        takes=NUMBERS,
        wraps=True,
        real=operator.mul,
        whole=operator.mul,
        interval=intervals.mul,
        nan=unless_finite,
        rewrite=simplify.mul,
        c99=C99(infix="*", whole="(T)((U)a * (U)b)"),
        cxx=Cxx("{} * {}"),
    ),
    Op(
        name="div",
        arity=2,
        takes=NUMBERS,
        real=arithmetic.divide,
        whole=arithmetic.quotient,
        interval=intervals.div,
        nan=intervals.unless_divisible,
        rewrite=simplify.div,
        c99=C99(
            infix="/",
            whole="b == 0 ? -1 : b == -1 ? (T)((U)0 - (U)a) : a / b",
            unsigned="b == 0 ? (T)-1 : a / b",
        ),
        cxx=Cxx("{} / {}"),
    ),
    Op(
        name="rem",
        arity=2,
        takes=NUMBERS,
        real=math.fmod,
        whole=arithmetic.remainder,
        interval=intervals.rem,
        rewrite=simplify.rem,
        c99=C99(
            infix="%",
            library="fmod",
            whole="b == 0 ? a : b == -1 ? 0 : a % b",
            unsigned="b == 0 ? a : a % b",
        ),
        cxx=Cxx("remainder_of({}, {})"),
    ),
    Op(
        name="neg",
        arity=1,
        takes=NUMBERS,
        wraps=True,
        real=arithmetic.negative,
        whole=arithmetic.negative,
        interval=intervals.neg,
        nan=never,
        rewrite=simplify.neg,
        c99=C99(prefix=("-", ""), whole="(T)((U)0 - (U)a)"),
        cxx=Cxx("-{}"),
    ),
    Op(
        name="abs",
        arity=1,
        takes="fil",
        wraps=True,
        real=math.fabs,
        whole=arithmetic.magnitude,
        interval=intervals.magnitude,
        nan=never,
        c99=C99(library="fabs", whole="a > 0 ? a : (T)((U)0 - (U)a)"),
        cxx=Cxx("magnitude({})"),
    ),
    Op(
        name="sign",
        arity=1,
        takes=NUMBERS,
        real=arithmetic.sign,
        whole=arithmetic.whole_sign,
        interval=between(-1, 1),
        nan=never,
        c99=C99(
            real=("real sign_real(real a)", "a > 0 ? (real)1 : a < 0 ? (real)-1 : a"),
            whole="(a > 0) - (a < 0)",
        ),
        cxx=Cxx("sign({})"),
    ),
    Op(
        name="min",
        arity=2,
        takes=NUMBERS,
        real=arithmetic.minimum,
        whole=min,
        interval=intervals.extreme(min),
        nan=never,
        rewrite=simplify.minimum,
        c99=C99(
            real=(
                "real min_real(real a, real b)",
                "a < b ? a : b < a ? b : a == b && a != 0 ? a : -(-a - b)",
            ),
            whole="a < b ? a : b",
        ),
        cxx=Cxx("smaller({}, {})"),
    ),
    Op(
        name="max",
        arity=2,
        takes=NUMBERS,
        real=arithmetic.maximum,
        whole=max,
        interval=intervals.extreme(max),
        nan=never,
        rewrite=simplify.maximum,
        c99=C99(
            real=(
                "real max_real(real a, real b)",
                "a > b ? a : b > a ? b : a == b && a != 0 ? a : a + b",
            ),
            whole="a > b ? a : b",
        ),
        cxx=Cxx("larger({}, {})"),
    ),
    Op(
        name="pow",
        arity=2,
        real=math.pow,
        c99=C99(library="pow"),
        cxx=Cxx("f_pow({}, {})"),
    ),
    Op(
        name="atan2",
        arity=2,
        real=math.atan2,
        nan=never,
        c99=C99(library="atan2"),
        cxx=Cxx("f_atan2({}, {})"),
    ),
)

_FUNCTIONS = (
    _function("floor", "floored", arithmetic.floor, intervals.rounded, never),
    _function("ceil", "ceiled", arithmetic.ceil, intervals.rounded, never),
    _function(
        "round",
        "rounded",
        arithmetic.round_half_even,
        intervals.rounded,
        never,
        C99(library="rint"),
    ),
    _function("exp", "exponential", math.exp, between(0, math.inf), never),
    _function("exp2", "f_exp2", arithmetic.exp2, between(0, math.inf), never),
    _function("expm1", "exponential_less_one", math.expm1, nan=never),
    _function("log", "f_log", math.log),
    _function("log1p", "f_log1p", math.log1p),
    _function("sqrt", "root", math.sqrt, between(0, math.inf), of_negative),
    _function(
        "rsqrt",
        "inverse_root",
        arithmetic.rsqrt,
        c99=C99(real=("real reciprocal_root(real a)", "1 / sqrt(a)")),
    ),
    _function("cbrt", "f_cbrt", None, nan=never),
    _function("sin", "f_sin", math.sin, between(-1, 1), unless_finite),
    _function("cos", "f_cos", math.cos, between(-1, 1), unless_finite),
    _function("tan", "f_tan", math.tan),
    _function("asin", "f_asin", math.asin),
    _function("acos", "f_acos", math.acos),
    _function("atan", "f_atan", math.atan, nan=never),
    _function("sinh", "f_sinh", math.sinh, nan=never),
    _function("cosh", "f_cosh", math.cosh, nan=never),
    _function("tanh", "hyperbolic_tangent", math.tanh, between(-1, 1), never),
    _function("asinh", "f_asinh", math.asinh, nan=never),
    _function("acosh", "f_acosh", math.acosh),
    _function("atanh", "f_atanh", math.atanh),
    _function(
        "logistic",
        "logistic",
        arithmetic.logistic,
        between(0, 1),
        never,
        C99(real=("real logistic(real a)", "1 / (1 + exp(-a))")),
    ),
    _function("erf", "f_erf", math.erf, between(-1, 1), never),
    _function("erf_inv", "", None, c99=C99()),
)

_LOGIC = (
    _comparison("eq", "==", operator.eq, "none(differ({}, {}))"),
    _comparison("ne", "!=", operator.ne, "differ({}, {})"),
    _comparison("lt", "<", operator.lt),
    _comparison("le", "<=", operator.le),
    _comparison("gt", ">", operator.gt),
    _comparison("ge", ">=", operator.ge),
    Op(
        name="and",
        arity=2,
        takes=BITS,
        wraps=True,
        whole=arithmetic.bit_and,
        interval=intervals.bits_of,
        rewrite=simplify.both,
        c99=C99(logic=("&&", "&")),
        cxx=Cxx("{} & {}", truth="both({}, {})"),
    ),
    Op(
        name="or",
        arity=2,
        takes=BITS,
        wraps=True,
        whole=arithmetic.bit_or,
        rewrite=simplify.either,
        c99=C99(logic=("||", "|")),
        cxx=Cxx("{} | {}", truth="either({}, {})"),
    ),
    Op(
        name="xor",
        arity=2,
        takes=BITS,
        wraps=True,
        whole=arithmetic.bit_xor,
        c99=C99(logic=("!=", "^")),
        cxx=Cxx("{} ^ {}", truth="differ({}, {})"),
    ),
    Op(
        name="not",
        arity=1,
        takes=BITS,
        wraps=True,
        whole=arithmetic.invert,
        rewrite=simplify.negation,
        c99=C99(prefix=("~", "!")),
        cxx=Cxx("~{}", truth="none({})"),
    ),
    Op(
        name="shl",
        arity=2,
        takes=INTEGERS,
        primitive=False,
        wraps=True,
        whole=arithmetic.shift_left,
        c99=C99(whole="(U)b < 8 * sizeof a ? (T)((U)a << b) : 0"),
        cxx=Cxx("{} << {}"),
    ),
    Op(
        name="shr",
        arity=2,
        takes=INTEGERS,
        primitive=False,
        wraps=True,
        whole=arithmetic.shift_right,
        c99=C99(whole="(U)b < 8 * sizeof a ? (T)((U)a >> b) : 0"),
        cxx=Cxx("shifted_right({}, {})"),
    ),
    Op(
        name="is_finite",
        arity=1,
        gives="b",
        real=math.isfinite,
        rewrite=simplify.is_finite,
        c99=C99(real=("bool is_finite(real a)", "a - a == 0")),
        cxx=Cxx("finite({})"),
    ),
    Op(
        name="select",
        arity=3,
        takes=ANY,
        primitive=False,
        real=arithmetic.choose,
        whole=arithmetic.choose,
        interval=intervals.select,
        nan=never,
        rewrite=simplify.select,
    ),
    Op(
        name="cast",
        arity=1,
        takes=ANY,
        gives="?",
        primitive=False,
        interval=intervals.cast,
        nan=never,
        rewrite=simplify.cast,
    ),
)

#: every operation by its name
OPS: dict[str, Op] = {op.name: op for op in (*_LEAVES, *_ARITHMETIC, *_FUNCTIONS, *_LOGIC)}
