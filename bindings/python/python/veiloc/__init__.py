"""Visual localization in which neither the image nor the keypoint positions leave the device.

- Poses from correspondences, with PoseLib's calling convention: `estimate_absolute_pose`, `estimate_absolute_pose_lines`,
  `estimate_absolute_pose_anchored`, and the minimal solvers `p3p`, `p6lp`, `p5lp_radial`, `p6lp_dual_radial`, `up2p`, `u4lp`.
- The device: `extract`, `obfuscate`, `seal`, `Session`, `Profile`, and `Client` for a service.
- The server: `Map`; `read_posed` for poses of other programs; `prepare` and `veiloc.ray` to build a map on several machines.
- Privacy attacks: `attack`, `audit`.
- `render_room`: a synthetic scene for experiments.
- `veiloc.hloc`: the last step of hloc, with lines instead of points.

Pixels are COLMAP's: the centre of the first pixel is (0.5, 0.5). Poses are world to camera. All errors are `veiloc.Error`.
"""

from veiloc._native import (
    VERSION as __version__,
    Answer,
    CameraPose,
    Client,
    ColmapModel,
    Map,
    Profile,
    Session,
    anchored_lines,
    attack,
    attack_names,
    audit,
    describe_query,
    device_limits,
    estimate_absolute_pose,
    estimate_absolute_pose_anchored,
    estimate_absolute_pose_lines,
    extract,
    obfuscate,
    p3p,
    p5lp_radial,
    p6lp,
    p6lp_dual_radial,
    prepare,
    read_posed,
    render_room,
    seal,
    u4lp,
    undistort,
    up2p,
)
from veiloc.errors import (
    BusyError,
    Error,
    ImageError,
    InputError,
    MapError,
    NotLocalizedError,
    QueryError,
    RefusedError,
    ServiceError,
    WrongProfileError,
)
from veiloc.notebook import ProgressBar

__all__ = [
    "Answer",
    "BusyError",
    "CameraPose",
    "Client",
    "ColmapModel",
    "Error",
    "ImageError",
    "InputError",
    "Map",
    "MapError",
    "NotLocalizedError",
    "Profile",
    "ProgressBar",
    "QueryError",
    "RefusedError",
    "ServiceError",
    "Session",
    "WrongProfileError",
    "__version__",
    "anchored_lines",
    "attack",
    "attack_names",
    "audit",
    "describe_query",
    "device_limits",
    "estimate_absolute_pose",
    "estimate_absolute_pose_anchored",
    "estimate_absolute_pose_lines",
    "extract",
    "obfuscate",
    "p3p",
    "p5lp_radial",
    "p6lp",
    "p6lp_dual_radial",
    "prepare",
    "read_posed",
    "render_room",
    "seal",
    "u4lp",
    "undistort",
    "up2p",
]
