"""The frame of a kernel's source: functions, the handler that XLA calls, sizes."""

from typing import NamedTuple

from jaxstage.compiler.cxx.emit import copies
from jaxstage.compiler.cxx.hoist import Hoisted, hoist
from jaxstage.compiler.cxx.layout import Layout, cells
from jaxstage.compiler.frontend.lower import Lowered
from jaxstage.compiler.frontend.step_program import Program
from jaxstage.compiler.passes.store_forms import COPY, Store


class Source(NamedTuple):
    """What the pieces of a source have in common. borders: C++ that defines `begin` and `end`, what
    is done before and after the time loop of a vector of runs. tables: as further arguments of a
    call."""

    program: Program
    low: Lowered
    where: Layout
    hoisted: Hoisted
    borders: str
    tables: str

    @property
    def passed(self) -> str:
        """Arguments of one function to another."""
        return f"r, ri, row, rowi, NB{self.tables}"


def source_of(program: Program, low: Lowered, where: Layout, stores: list[Store]) -> Source:
    """The frame of a kernel that computes the stores in each tick."""
    hoisted = hoist(low, stores, cells(where))
    begin = [
        *hoisted.lines,
        "for (int i = 0; i < NC; i++) c[i] = load(C + i * NB + b);",
        "for (int i = 0; i < NCI; i++) ci[i] = load_ints(CI + i * NB + b);",
    ]
    borders = f"""auto begin = [&](int64_t b, vec* h, ints* hi, vec* c, ints* ci) {{
    {_joined(begin)}
  }};
  auto end = [&](int64_t b, const vec* c, const ints* ci) {{
    for (int i = 0; i < NC; i++) store(C1 + i * NB + b, c[i]);
    for (int i = 0; i < NCI; i++) store_ints(CI1 + i * NB + b, ci[i]);
  }};"""
    tables = "".join(f", T{i}" for i in range(len(low.tables)))
    return Source(program, low, where, hoisted, borders, tables)


def _tables(source: Source) -> list[str]:
    """C types of the tables."""
    kinds = {}
    for node in source.low.graph.nodes:
        if node.op == "load" and node.value[0][0] == "t":
            kinds[node.value[0][1]] = "real" if node.kind == "f" else "int32_t"
    return [kinds.get(i, "real") for i in range(len(source.low.tables))]


def text_of(
    source: Source, name: str, statements: list[str], together: int, more: str = "",
    seldom: bool = False,
) -> str:  # fmt: skip
    """A C++ function of statements on several vectors. more: parameters; seldom: is it called?"""
    tables = "".join(f", const {kind}* T{i}" for i, kind in enumerate(_tables(source)))
    kind = "noinline, cold" if seldom else "always_inline"
    return f"""
static {"" if seldom else "inline "}__attribute__(({kind})) void {name}(
    vec (*c)[NC], ints (*ci)[NCI], vec (*d)[ND], vec (*a)[NA], const vec (*h)[NH],
    const ints (*hi)[NHI], const real* __restrict r, const int32_t* __restrict ri, real* row,
    int32_t* rowi, int64_t NB{tables}{more}) {{
  {_joined([*copies([*_ARRAYS], together), *statements])}
}}
"""


def holds(condition: str, together: int) -> str:
    """C text: whether a condition holds in every lane of all vectors."""
    return " && ".join(copies([f"everywhere({condition})"], together))


def _joined(statements: list[str]) -> str:
    return "\n  ".join(statements)


#: the arrays of a vector; cotangents stand where tangents do
_ARRAYS = (
    f"vec* __restrict c{COPY} = c[{COPY}]; ints* __restrict ci{COPY} = ci[{COPY}];",
    f"vec* __restrict d{COPY} = d[{COPY}]; vec* __restrict g{COPY} = d[{COPY}];",
    f"vec* __restrict a{COPY} = a[{COPY}];",
    f"const vec* __restrict h{COPY} = h[{COPY}]; const ints* __restrict hi{COPY} = hi[{COPY}];",
    f"real* row{COPY} = row + {COPY} * LANES; int32_t* rowi{COPY} = rowi + {COPY} * LANES;",
)


def heading(source: Source, together: int) -> str:
    """Sizes; to be made after all functions, which find out what they read."""
    groups = source.where.groups
    sizes = {
        "NH": source.hoisted.reals, "NHI": source.hoisted.wholes,
        "NC": _cells(source, True), "NCI": _cells(source, False),
        "NR": len(groups["r"].real), "NRI": len(groups["r"].whole),
        "ND": _moving(source, "dg"), "NA": _moving(source, "qa"),
    }  # fmt: skip
    lines = [f"constexpr int {name} = {value};" for name, value in sizes.items()]
    return f"""#define REAL {"float" if source.low.single else "double"}
#include <algorithm>
#include "simd.h"
#include "xla/ffi/api/c_api.h"
{chr(10).join(lines)}
constexpr int TOGETHER = {together};  // vectors of runs that go through time together
struct State {{ vec c[TOGETHER][NC]; ints ci[TOGETHER][NCI]; }};
INLINE void keep(State& s, const vec (*c)[NC], const ints (*ci)[NCI]) {{
  memcpy(s.c, c, sizeof s.c);
  memcpy(s.ci, ci, sizeof s.ci);
}}
INLINE void take(const State& s, vec (*c)[NC], ints (*ci)[NCI]) {{
  memcpy(c, s.c, sizeof s.c);
  memcpy(ci, s.ci, sizeof s.ci);
}}
template <class T> T* in(XLA_FFI_CallFrame* f, int i) {{
  return (T*)((XLA_FFI_Buffer*)f->args.args[i])->data;
}}
template <class T> T* out(XLA_FFI_CallFrame* f, int i) {{
  return (T*)((XLA_FFI_Buffer*)f->rets.rets[i])->data;
}}
static XLA_FFI_Error* failed(XLA_FFI_CallFrame* f, const char* why) {{
  XLA_FFI_Error_Create_Args args{{}};
  args.struct_size = XLA_FFI_Error_Create_Args_STRUCT_SIZE;
  args.message = why;
  args.errc = XLA_FFI_Error_Code_RESOURCE_EXHAUSTED;
  return f->api->XLA_FFI_Error_Create(&args);
}}
"""


def _cells(source: Source, real: bool) -> int:
    leaves = source.program.carry
    return sum(leaves[number].size for number, (r, _) in source.where.carry.items() if r == real)


def _moving(source: Source, names: str) -> int:
    program = source.program
    first, second = names
    leaves = program.carry if first == "d" else program.leaves
    return sum(leaves[number].size for name, number in source.where.moving if name == second)


def handler(source: Source, head: str, body: str) -> str:
    """The function that XLA calls: its arguments by name, then the work."""
    tables = "".join(
        f"\n  const {kind}* T{i} = in<{kind}>(frame, {8 + i});"
        for i, kind in enumerate(_tables(source))
    )
    return f"""
extern "C" XLA_FFI_Error* kernel(XLA_FFI_CallFrame* frame) {{
  auto* extension = frame->extension_start;
  if (extension && extension->type == XLA_FFI_Extension_Metadata) {{
    auto* metadata = ((XLA_FFI_Metadata_Extension*)extension)->metadata;
    metadata->api_version.major_version = XLA_FFI_API_MAJOR;
    metadata->api_version.minor_version = XLA_FFI_API_MINOR;
    return nullptr;
  }}
  const real *P = in<real>(frame, 0), *S = in<real>(frame, 2), *R = in<real>(frame, 4);
  const int32_t *PI = in<int32_t>(frame, 1), *SI = in<int32_t>(frame, 3);
  const int32_t* RI = in<int32_t>(frame, 5);
  const real* C = in<real>(frame, 6);
  const int32_t* CI = in<int32_t>(frame, 7);
  const int64_t N = ((XLA_FFI_Buffer*)frame->args.args[4])->dims[0];
  const int64_t NB = ((XLA_FFI_Buffer*)frame->args.args[6])->dims[1];{tables}
  {head}
  {body}
  return nullptr;
}}
"""
