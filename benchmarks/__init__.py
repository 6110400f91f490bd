"""Speed of jaxstage, measured against hand-written C++, numpy and scipy in the same minutes."""

import os

# XLA compares tuning flags where it takes a program from the cache, and logs kilobytes about it
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
