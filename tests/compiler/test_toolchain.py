"""The C++ compiler and the cache of kernels: what CXX may hold, what is damaged or not ours."""

import os
import platform
import shlex
import stat
import time
import warnings
from itertools import count

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import erf

from jaxstage.compiler.cxx.kernels import kernel
from jaxstage.compiler.frontend.step_program import StepSpec
from jaxstage.compiler.ir.errors import LoweringError
from jaxstage.compiler.runtime import api, toolchain
from jaxstage.system import files

number = count()


@pytest.fixture(scope="module")
def unit():
    """The translation unit of a small loop."""
    spec = StepSpec(lambda static, inputs, shared, carry: (carry + inputs, None))
    program, _ = api.program_of(spec, jnp.ones(()), (), jnp.zeros(()))
    return kernel(program, "forward", (False,)).text(1)


@pytest.fixture
def text(unit):
    """A unit that no other test has built."""
    return f"{unit}// {next(number)} of {os.getpid()}\n"


@pytest.fixture
def kernels(tmp_path):
    """An empty cache: the folder of its kernels."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    toolchain._folder.cache_clear()
    yield tmp_path / "kernels"
    jax.config.update("jax_compilation_cache_dir", before)
    toolchain._folder.cache_clear()


@pytest.fixture
def overdue():
    """Forget afterwards that a kernel took too long."""
    yield toolchain._overdue
    toolchain._overdue.cache_clear()


def built(text):
    """`build`, without what the process remembers."""
    return toolchain.build.__wrapped__(text)


def compiled(text):
    """The file of a library that is compiled and not loaded."""
    chosen = toolchain.compiler()
    file = toolchain.library_file(text, chosen)
    toolchain._compile(chosen, text, file)
    return file


def script(folder, name, body):
    """An executable shell script."""
    file = folder / name
    file.write_text(f"#!/bin/sh\n{body}\n", encoding="utf-8")
    file.chmod(0o755)
    return file


# --- the cache -----------------------------------------------------------------------------------


def zero_pages(data):
    return data[:4096] + bytes(4096) + data[8192:]


def flip_a_bit(data):
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


DAMAGES = {
    "cut short": lambda data: data[:4096],
    "cut by one byte": lambda data: data[:-1],
    "zeroed pages": zero_pages,
    "one bit": flip_a_bit,
    "empty": lambda data: b"",
    "no library": lambda data: b"not a library",
    "no digest": lambda data: data[: -toolchain.DIGEST],
    "longer": lambda data: data + b"\0",
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_library_is_built_again(text, kernels, damage):
    """Loading a library that is cut short or zeroed would end the process."""
    file = compiled(text)
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    assert toolchain._opened(file) is None
    library = built(text)
    assert not library.cached and library.seconds > 0
    assert toolchain._opened(file) is not None
    assert built(text).cached
    assert library.bytes == len(file.read_bytes()) - toolchain.DIGEST


def test_what_the_cache_makes_is_private(text, kernels):
    mask = os.umask(0)
    try:
        file = compiled(text)
    finally:
        os.umask(mask)
    assert stat.S_IMODE(kernels.stat().st_mode) == 0o700
    assert not file.stat().st_mode & 0o077
    assert [x.name for x in kernels.iterdir()] == [file.name]


def test_a_library_that_others_may_write_is_not_loaded(text, kernels):
    file = compiled(text)
    file.chmod(0o666)
    with pytest.warns(UserWarning, match=rf"built anew: {file}: others may write it \(mode 666\)"):
        assert not built(text).cached
    assert not file.stat().st_mode & 0o077 and built(text).cached


def test_a_library_of_somebody_else_is_not_loaded(text, kernels, monkeypatch):
    file = compiled(text)
    owner = os.geteuid()
    monkeypatch.setattr(files.os, "geteuid", lambda: owner + 1)
    with pytest.warns(UserWarning, match=rf"built anew: {file}: it belongs to user {owner}"):
        assert toolchain._opened(file) is None


def test_a_folder_that_others_may_write_keeps_no_kernels(text, kernels):
    kernels.mkdir(mode=0o700)
    kernels.chmod(0o777)
    with pytest.warns(UserWarning, match=rf"no cache of kernels: {kernels}: others may write it"):
        assert toolchain._folder() != kernels
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # it has been said
        assert not built(text).cached
    assert not list(kernels.iterdir())


def test_what_a_killed_compilation_leaves_is_removed(text, kernels):
    kernels.mkdir(mode=0o700)
    old, young = kernels / "tmp1", kernels / "tmp2"
    for folder in (old, young):
        folder.mkdir()
        (folder / "kernel.cc").write_text("half", encoding="utf-8")
    past = time.time() - 2 * toolchain.LIMIT - 1
    os.utime(old, (past, past))
    file = compiled(text)
    assert sorted(x.name for x in kernels.iterdir()) == sorted([file.name, young.name])


# --- the compiler --------------------------------------------------------------------------------


def chosen_by(monkeypatch, words):
    monkeypatch.setenv("CXX", words)
    return toolchain.compiler.__wrapped__()


def test_cxx_is_read_as_a_shell_does(text, kernels, monkeypatch, tmp_path):
    real = toolchain.compiler().command[0]
    wrapper = script(tmp_path, "my wrapper", 'exec "$@"')
    words = f"{shlex.quote(str(wrapper))} {real} -m64"
    chosen = chosen_by(monkeypatch, words)
    assert chosen.command == (str(wrapper), real, "-m64") and chosen.name == f"CXX = {words}"
    assert chosen.version == toolchain.compiler().version
    monkeypatch.setattr(toolchain, "compiler", lambda: chosen)
    assert built(text).seconds > 0


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("/no/such/g++ -O2", "there is no program '/no/such/g++'"),
        ("'g++", "No closing quotation"),
        ("false", "--version ends with status 1"),
    ],
)
def test_a_wrong_cxx_is_named(monkeypatch, words, reason):
    assert chosen_by(monkeypatch, words) == f"CXX = {words}: {reason}"


def test_without_cxx_the_first_compiler_is_taken(monkeypatch):
    monkeypatch.setenv("CXX", " ")
    assert toolchain.compiler.__wrapped__() == toolchain.compiler()
    monkeypatch.setattr(toolchain, "COMPILERS", ("no-such-compiler",))
    assert toolchain.compiler.__wrapped__() == "no C++ compiler (g++ or clang++) was found"


def test_a_compiler_that_does_not_answer_is_left(monkeypatch, tmp_path):
    silent = script(tmp_path, "silent", "sleep 60 & wait")
    monkeypatch.setattr(toolchain, "ANSWER", 0.3)
    begin = time.perf_counter()
    assert chosen_by(monkeypatch, str(silent)) == f"CXX = {silent}: no answer to --version in 0.3 s"
    assert time.perf_counter() - begin < 30


def test_a_compiler_that_hangs_is_ended_with_its_children(
    text, kernels, overdue, monkeypatch, tmp_path
):
    pids = tmp_path / "pids"
    body = f'[ "$1" = --version ] && exit 0\necho $$ > {pids}\nsleep 60 &\necho $! >> {pids}\nwait'
    hanging = script(tmp_path, "hanging", body)
    chosen = chosen_by(monkeypatch, str(hanging))
    monkeypatch.setattr(toolchain, "compiler", lambda: chosen)
    monkeypatch.setenv(toolchain.LIMIT_NAME, "1.5")
    reason = rf"CXX = {hanging} took more than 1.5 s \(JAXSTAGE_COMPILE_SECONDS changes that\)"
    with pytest.raises(LoweringError, match=reason):
        built(text)
    for pid in pids.read_text(encoding="utf-8").split():
        assert not running(int(pid))
    monkeypatch.setattr(toolchain, "_run", lambda *a: pytest.fail("tried again"))
    with pytest.raises(LoweringError, match=reason):
        built(text + "// another\n")
    assert not list(kernels.iterdir())


def running(pid):
    """Whether a process runs, for a second at most."""
    for _ in range(50):
        try:
            with open(f"/proc/{pid}/stat", encoding="utf-8") as stream:
                if stream.read().rpartition(")")[2].split()[0] == "Z":
                    return False
        except OSError:
            return False
        time.sleep(0.02)
    return True


@pytest.mark.parametrize("words", ["0", "-1", "nan", "inf", "soon"])
def test_a_wrong_time_limit_is_named(monkeypatch, words):
    monkeypatch.setenv(toolchain.LIMIT_NAME, words)
    with pytest.raises(LoweringError, match=f"_COMPILE_SECONDS = {words}: must be a number"):
        toolchain.time_limit()


def test_a_compiler_that_fails_says_what(text, kernels, monkeypatch, tmp_path):
    body = '[ "$1" = --version ] && exit 0\necho "kernel.cc:1: error: no space left" >&2\nexit 1'
    failing = script(tmp_path, "failing", body)
    chosen = chosen_by(monkeypatch, str(failing))
    monkeypatch.setattr(toolchain, "compiler", lambda: chosen)
    with pytest.raises(LoweringError, match=rf"CXX = {failing} failed: .* no space left"):
        built(text)
    assert not list(kernels.iterdir())


# --- every function ------------------------------------------------------------------------------

#: every elementary function that a kernel may call, of u in (-1, 1) and w in (1, 20); its oracle
FUNCTIONS = {
    "sin": (lambda u, w: jnp.sin(w), lambda u, w: np.sin(w)),
    "cos": (lambda u, w: jnp.cos(w), lambda u, w: np.cos(w)),
    "tan": (lambda u, w: jnp.tan(u), lambda u, w: np.tan(u)),
    "asin": (lambda u, w: jnp.arcsin(u), lambda u, w: np.arcsin(u)),
    "acos": (lambda u, w: jnp.arccos(u), lambda u, w: np.arccos(u)),
    "atan": (lambda u, w: jnp.arctan(w), lambda u, w: np.arctan(w)),
    "sinh": (lambda u, w: jnp.sinh(u), lambda u, w: np.sinh(u)),
    "cosh": (lambda u, w: jnp.cosh(u), lambda u, w: np.cosh(u)),
    "tanh": (lambda u, w: jnp.tanh(u), lambda u, w: np.tanh(u)),
    "asinh": (lambda u, w: jnp.arcsinh(w), lambda u, w: np.arcsinh(w)),
    "acosh": (lambda u, w: jnp.arccosh(w), lambda u, w: np.arccosh(w)),
    "atanh": (lambda u, w: jnp.arctanh(u), lambda u, w: np.arctanh(u)),
    "exp": (lambda u, w: jnp.exp(u), lambda u, w: np.exp(u)),
    "exp2": (lambda u, w: jnp.exp2(u), lambda u, w: np.exp2(u)),
    "expm1": (lambda u, w: jnp.expm1(u), lambda u, w: np.expm1(u)),
    "log": (lambda u, w: jnp.log(w), lambda u, w: np.log(w)),
    "log1p": (lambda u, w: jnp.log1p(u), lambda u, w: np.log1p(u)),
    "sqrt": (lambda u, w: jnp.sqrt(w), lambda u, w: np.sqrt(w)),
    "rsqrt": (lambda u, w: jax.lax.rsqrt(w), lambda u, w: 1 / np.sqrt(w)),
    "cbrt": (lambda u, w: jnp.cbrt(w), lambda u, w: np.cbrt(w)),
    "erf": (lambda u, w: jax.lax.erf(u), lambda u, w: erf(u)),
    "logistic": (lambda u, w: jax.nn.sigmoid(u), lambda u, w: 1 / (1 + np.exp(-u))),
    "pow": (lambda u, w: w**u, lambda u, w: w**u),
    "atan2": (lambda u, w: jnp.arctan2(u, w), lambda u, w: np.arctan2(u, w)),
    "rem": (lambda u, w: jax.lax.rem(w, 3 * jnp.ones_like(w)), lambda u, w: np.fmod(w, 3.0)),
}


#: options that make a kernel one of an older processor, or without the vector library of glibc
OLDER = ("-mno-avx512f", "-mno-avx", "-DNO_LIBMVEC") if platform.machine() == "x86_64" else ()


@pytest.fixture(params=["", *OLDER], ids=lambda option: option or "as it is")
def option(request, monkeypatch):
    """Kernels with one more option of the compiler."""
    monkeypatch.setattr(toolchain, "FLAGS", (*toolchain.FLAGS, *request.param.split()))
    toolchain.build.cache_clear()
    yield
    toolchain.build.cache_clear()


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_every_function_has_a_kernel_that_loads(dtype, option):
    random = np.random.default_rng(0)
    u = jnp.asarray(random.uniform(-0.99, 0.99, 40), dtype)
    w = jnp.asarray(random.uniform(1.01, 20.0, 40), dtype)

    def step(static, inputs, shared, carry):
        return jnp.stack([of(*inputs) for of, _ in FUNCTIONS.values()]), None

    def one(u, w):
        spec, start = StepSpec(step, strict=True), jnp.zeros(len(FUNCTIONS), dtype)
        return api.rollout(*api.program_of(spec, (u, w), (), start), 1)[0]

    values = jax.jit(jax.vmap(one))(u, w)
    assert values.dtype == dtype
    for number, (name, (_, oracle)) in enumerate(FUNCTIONS.items()):
        expected = oracle(np.asarray(u, float), np.asarray(w, float))
        size = np.maximum(np.abs(expected), 1.0)  # sine and cosine pass through 0
        error = np.max(np.abs(np.asarray(values[:, number], float) - expected) / size)
        assert error < 8 * jnp.finfo(dtype).eps, name
