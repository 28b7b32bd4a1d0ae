"""Types of the native part; what each does is in its docstring (`help(veiloc.seal)`)."""

from collections.abc import Callable, Iterable, Sequence
from os import PathLike
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

VERSION: str

Floats: TypeAlias = npt.NDArray[np.float64]
Ints: TypeAlias = npt.NDArray[np.int64]
Path: TypeAlias = str | PathLike[str]
Camera: TypeAlias = dict[str, Any] | str | Any
Image: TypeAlias = Path | npt.NDArray[np.uint8] | npt.NDArray[np.float32]
Mask: TypeAlias = Path | npt.NDArray[np.bool_]
Options: TypeAlias = dict[str, Any]
Progress: TypeAlias = Callable[[str, int, int], object]
Posed: TypeAlias = Path | Iterable[tuple[str, Camera, CameraPose]]
Gravity: TypeAlias = Sequence[Any]
Frames: TypeAlias = Iterable[tuple[bytes, CameraPose] | tuple[bytes, CameraPose, float, float]]

class CameraPose:
    def __init__(
        self, q: npt.ArrayLike | None = None, t: npt.ArrayLike | None = None, *, R: npt.ArrayLike | None = None
    ) -> None: ...
    @property
    def q(self) -> Floats: ...
    @property
    def t(self) -> Floats: ...
    @property
    def R(self) -> Floats: ...
    @property
    def Rt(self) -> Floats: ...
    @property
    def center(self) -> Floats: ...
    def error(self, other: CameraPose) -> tuple[float, float]: ...
    def __eq__(self, other: object) -> bool: ...

class Answer:
    @property
    def pose(self) -> CameraPose | None: ...
    @property
    def center(self) -> Floats | None: ...
    @property
    def covariance(self) -> Floats: ...
    @property
    def center_covariance(self) -> Floats | None: ...
    @property
    def trusted(self) -> bool: ...
    @property
    def position_sd(self) -> float: ...
    @property
    def state(self) -> str: ...
    @property
    def doubts(self) -> list[str]: ...
    @property
    def log_evidence(self) -> float: ...
    @property
    def inliers(self) -> int: ...
    @property
    def matches(self) -> int: ...
    @property
    def iterations(self) -> int: ...
    @property
    def noise_px(self) -> float | None: ...
    @property
    def focal_scale(self) -> float | None: ...
    @property
    def gravity(self) -> str | None: ...
    @property
    def retrieved(self) -> list[str]: ...
    @property
    def ms(self) -> dict[str, float]: ...
    @property
    def frames(self) -> list[CameraPose]: ...
    def __bool__(self) -> bool: ...

class Profile:
    @staticmethod
    def open(path: Path) -> Profile: ...
    @staticmethod
    def from_bytes(data: bytes) -> Profile: ...
    @property
    def id(self) -> str: ...
    @property
    def features(self) -> str: ...
    @property
    def global_descriptor(self) -> str: ...
    @property
    def max_keypoints(self) -> int: ...
    @property
    def max_image_side(self) -> int: ...
    def __bytes__(self) -> bytes: ...
    def __eq__(self, other: object) -> bool: ...
    def __hash__(self) -> int: ...

class Session:
    def __init__(self, *, anchors: str = "world") -> None: ...
    @staticmethod
    def from_bytes(data: bytes) -> Session: ...
    @staticmethod
    def open(path: Path) -> Session: ...
    def seal(
        self,
        image: Image,
        camera: Camera | None,
        profile: Profile,
        *,
        orientation: npt.ArrayLike | None = None,
        down: npt.ArrayLike | None = None,
        scheme: str = "dcl",
        max_keypoints: int | None = None,
        angle_bits: int = 12,
        gravity: npt.ArrayLike | None = None,
        focal: str | None = None,
        mask: Mask | None = None,
    ) -> bytes: ...
    @property
    def frames(self) -> int: ...
    @property
    def starts(self) -> int: ...
    def __bytes__(self) -> bytes: ...

class Map:
    @staticmethod
    def build(
        posed: Posed,
        images: Path,
        *,
        names: Sequence[str] | None = None,
        features: str = "compact",
        down: npt.ArrayLike | str | None = None,
        self_test: bool = True,
        skip_bad: bool = False,
        work: Path | None = None,
        progress: Progress | None = None,
    ) -> Map: ...
    @staticmethod
    def from_colmap(
        model: Path,
        images: Path,
        *,
        features: str = "compact",
        down: npt.ArrayLike | str | None = None,
        self_test: bool = True,
        skip_bad: bool = False,
        progress: Progress | None = None,
    ) -> Map: ...
    @staticmethod
    def open(path: Path) -> Map: ...
    def save(self, path: Path) -> None: ...
    def add(
        self,
        posed: Posed,
        images: Path,
        *,
        names: Sequence[str] | None = None,
        self_test: bool = True,
        skip_bad: bool = False,
        progress: Progress | None = None,
    ) -> Map: ...
    def remove(
        self,
        names: Sequence[str],
        *,
        retrain: bool = False,
        self_test: bool = True,
        progress: Progress | None = None,
    ) -> Map: ...
    def self_test(
        self, *, images: int = 50, schemes: Sequence[str] | None = None, progress: Progress | None = None
    ) -> dict[str, dict[str, Any]]: ...
    def self_test_share(
        self, share: tuple[int, int], *, images: int = 50, progress: Progress | None = None
    ) -> list[Any]: ...
    def with_self_test(self, shares: Sequence[Sequence[Any]], *, images: int = 50) -> Map: ...
    def localize(
        self,
        query: bytes,
        *,
        retrieve: int = 10,
        use_prior: bool = True,
        ransac_opt: Options | None = None,
        bundle_opt: Options | None = None,
        position: npt.ArrayLike | None = None,
    ) -> Answer: ...
    def localize_rig(
        self,
        frames: Frames,
        *,
        retrieve: int = 10,
        use_prior: bool = True,
        ransac_opt: Options | None = None,
        bundle_opt: Options | None = None,
        position: npt.ArrayLike | None = None,
    ) -> Answer: ...
    @property
    def tested(self) -> dict[str, dict[str, Any]] | None: ...
    @property
    def profile(self) -> Profile: ...
    @property
    def image_names(self) -> list[str]: ...
    @property
    def poses(self) -> dict[str, CameraPose]: ...
    @property
    def points(self) -> Floats: ...
    @property
    def down(self) -> list[float] | None: ...
    @property
    def warnings(self) -> list[str]: ...
    def __len__(self) -> int: ...
    def _repr_svg_(self) -> str | None: ...

def prepare(
    posed: Posed,
    images: Path,
    work: Path,
    stage: str,
    share: tuple[int, int],
    *,
    names: Sequence[str] | None = None,
    features: str = "compact",
    skip_bad: bool = False,
    progress: Progress | None = None,
) -> tuple[int, int]: ...

class Client:
    def __init__(
        self,
        server: str,
        token: str | None = None,
        *,
        certificates: bytes | None = None,
        insecure_http: bool = False,
        timeout: float = 60.0,
        retries: int = 4,
        cache: Path | None = None,
    ) -> None: ...
    def profile(self, map: str) -> Profile: ...
    def localize(
        self, map: str, query: bytes, *, trusted_only: bool = False, near: npt.ArrayLike | None = None
    ) -> Answer: ...
    def localize_progressive(
        self,
        map: str,
        query: bytes,
        profile: Profile,
        *,
        position_sd: float | None = None,
        trusted_only: bool = False,
        near: npt.ArrayLike | None = None,
    ) -> tuple[Answer, list[dict[str, Any]]]: ...
    def localize_rig(
        self, map: str, frames: Frames, *, trusted_only: bool = False, near: npt.ArrayLike | None = None
    ) -> Answer: ...

class ColmapModel:
    @staticmethod
    def open(folder: Path) -> ColmapModel: ...
    @property
    def image_names(self) -> list[str]: ...
    def pose(self, name: str) -> CameraPose | None: ...
    def camera(self, name: str) -> dict[str, Any] | None: ...
    def point_rows(self, name: str) -> Ints | None: ...
    @property
    def points(self) -> Floats: ...
    def __len__(self) -> int: ...

def estimate_absolute_pose(
    points2d: npt.ArrayLike,
    points3d: npt.ArrayLike,
    camera: Camera,
    ransac_opt: Options | None = None,
    bundle_opt: Options | None = None,
    *,
    keypoints: npt.ArrayLike | None = None,
    prior: npt.ArrayLike | None = None,
    gravity: Gravity | None = None,
    position: npt.ArrayLike | None = None,
    focal: str = "calibrated",
) -> tuple[CameraPose, dict[str, Any]]: ...
def estimate_absolute_pose_lines(
    lines2d: npt.ArrayLike,
    points3d: npt.ArrayLike,
    camera: Camera,
    ransac_opt: Options | None = None,
    bundle_opt: Options | None = None,
    *,
    keypoints: npt.ArrayLike | None = None,
    prior: npt.ArrayLike | None = None,
    gravity: Gravity | None = None,
    position: npt.ArrayLike | None = None,
    focal: str = "calibrated",
) -> tuple[CameraPose, dict[str, Any]]: ...
def estimate_absolute_pose_anchored(
    anchors: npt.ArrayLike,
    angles: npt.ArrayLike,
    points3d: npt.ArrayLike,
    camera: Camera,
    ransac_opt: Options | None = None,
    bundle_opt: Options | None = None,
    *,
    layout: str = "dcl",
    layout_focal: float | None = None,
    keypoints: npt.ArrayLike | None = None,
    prior: npt.ArrayLike | None = None,
    gravity: Gravity | None = None,
    position: npt.ArrayLike | None = None,
    focal: str = "calibrated",
) -> tuple[CameraPose, dict[str, Any]]: ...
def anchored_lines(points2d: npt.ArrayLike, camera: Camera, layout: str = "dcl") -> tuple[Ints, Floats]: ...
def undistort(points2d: npt.ArrayLike, camera: Camera) -> Floats: ...
def p3p(bearings: npt.ArrayLike, points3d: npt.ArrayLike) -> list[CameraPose]: ...
def p6lp(lines: npt.ArrayLike, points3d: npt.ArrayLike) -> list[CameraPose]: ...
def p5lp_radial(directions: npt.ArrayLike, points3d: npt.ArrayLike) -> list[CameraPose]: ...
def p6lp_dual_radial(
    anchor: npt.ArrayLike,
    inward: npt.ArrayLike,
    sixth_axis: npt.ArrayLike,
    sixth_inward: npt.ArrayLike,
    points3d: npt.ArrayLike,
) -> list[CameraPose]: ...
def up2p(
    bearings: npt.ArrayLike,
    points3d: npt.ArrayLike,
    down_in_camera: npt.ArrayLike | None = None,
    down_in_world: npt.ArrayLike | None = None,
) -> list[CameraPose]: ...
def u4lp(
    lines: npt.ArrayLike,
    points3d: npt.ArrayLike,
    down_in_camera: npt.ArrayLike | None = None,
    down_in_world: npt.ArrayLike | None = None,
) -> list[CameraPose]: ...
def extract(
    image: Image,
    *,
    features: str = "compact",
    max_keypoints: int = 2048,
    max_image_side: int = 2048,
    mask: Mask | None = None,
) -> dict[str, Any]: ...
def obfuscate(
    points2d: npt.ArrayLike, width: int, height: int, scheme: str = "dcl", *, angle_bits: int = 12, seed: int = 0
) -> dict[str, Any]: ...
def seal(
    image: Image,
    camera: Camera | None,
    profile: Profile,
    *,
    scheme: str = "dcl",
    max_keypoints: int | None = None,
    angle_bits: int = 12,
    gravity: npt.ArrayLike | None = None,
    focal: str | None = None,
    mask: Mask | None = None,
) -> bytes: ...
def describe_query(query: bytes) -> dict[str, Any]: ...
def device_limits() -> dict[str, int]: ...
def attack_names() -> list[str]: ...
def attack(
    images: Sequence[Path],
    *,
    attacks: Sequence[str] | None = None,
    schemes: Sequence[str] | None = None,
    features: str = "compact",
    max_keypoints: int = 2048,
    max_image_side: int = 1600,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]: ...
def audit(
    images: Sequence[Path],
    *,
    attacks: Sequence[str] | None = None,
    schemes: Sequence[str] | None = None,
    features: str = "compact",
    max_keypoints: int = 2048,
    max_image_side: int = 1600,
    seed: int = 0,
    synthetic: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]: ...
def render_place(
    folder: Path, *, mapped: int = 10, queries: int = 3, seed: int = 11
) -> tuple[list[tuple[str, str, CameraPose]], list[tuple[str, str, CameraPose]]]: ...
def run_program(command_line: Sequence[str]) -> int: ...
