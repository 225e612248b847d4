"""One frame, from picture to measurement: the door to the package."""

from __future__ import annotations
