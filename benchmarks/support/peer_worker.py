"""Run lu-vp-detect on frames asked for by number; nothing of this project is imported here.

``python peer_worker.py FRAMES.npy SETTINGS-JSON``: a number per line on standard input, an object per line on output.
"""

from __future__ import annotations

import json
import sys
import time

import cv2
import numpy as np
from lu_vp_detect import VPDetection

# As in `clock.py`, which is not imported: this runs in another environment.
fine = time.get_clock_info("thread_time").resolution < 1e-5
clock = time.thread_time if fine else time.perf_counter


def main() -> None:
    """Time the peer's line finder on the frames whose numbers come by standard input."""
    cv2.setNumThreads(1)
    frames, settings = np.load(sys.argv[1]), json.loads(sys.argv[2])
    for line in sys.stdin:
        image = frames[int(line)]
        t0 = clock()
        cv2.Canny(cv2.GaussianBlur(image, (5, 5), 0), 50, 150)
        t1 = clock()
        try:
            vps = VPDetection(**settings).find_vps(image)
        except (ValueError, IndexError, TypeError, cv2.error):  # what it does with too few lines
            vps = None
        t2 = clock()
        answer = {
            "ms": 1e3 * (t2 - t1),
            "unit_ms": 1e3 * (t1 - t0),
            "vps": None if vps is None else np.asarray(vps).tolist(),
        }
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
