"""Imported by the process that local workers are forked from: loads what tasks need, compiled code included, once for all."""

from __future__ import annotations

import gc

from threadpoolctl import threadpool_limits

from pgcp.parallel import limited_to
from pgcp.patches.warm_up import warm_up

with threadpool_limits(1), limited_to(1):  # threads would not be there in a forked process
    warm_up()
gc.freeze()  # what is here stays: workers need not look at it, and share its memory
