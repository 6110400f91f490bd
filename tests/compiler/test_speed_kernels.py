"""The C++ kernels that jaxstage is timed against compute what jaxstage computes."""

import numpy as np
import pytest

from benchmarks.against_cxx import AGREE
from benchmarks.baselines import numpy_rollout
from benchmarks.cases import LAWS, work
from benchmarks.cxx_build import Kernel, Variant, compiler, widths
from benchmarks.jax_runs import batched, tracking_error

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no g++ to build the kernels with")
LANES, TICKS = 21, 300  # not a multiple of any vector; long enough to leave the first CMAC cell


@needs_compiler
@pytest.mark.parametrize("dtype", AGREE)
@pytest.mark.parametrize("law", LAWS)
def test_kernels_agree_with_jaxstage(law, dtype):
    runs = work(law, dtype, LANES, TICKS)
    expected = np.asarray(tracking_error(batched(runs, LANES, 1)()))
    assert np.ptp(expected) > 0.1 * expected.mean()  # the runs differ
    for variant, threads in ((Variant(widths()[0], 1, 1), 1), (Variant(widths()[-1], 2, 0), 2)):
        np.testing.assert_allclose(Kernel(runs, variant, threads)(), expected, rtol=AGREE[dtype])


def test_numpy_agrees_with_jaxstage():
    runs = work("dfcmac", "float64", LANES, TICKS)
    expected = np.asarray(tracking_error(batched(runs, LANES, 1)()))
    np.testing.assert_allclose(numpy_rollout(runs), expected, rtol=1e-9)
