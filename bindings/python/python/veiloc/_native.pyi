"""Types and docstrings of the native module. The docstrings are those of the Rust source (`src`); a test compares them."""

from collections.abc import Callable, Iterable, Sequence
from os import PathLike
from typing import Any, Literal, Protocol, TypeAlias, TypedDict

import numpy as np
import numpy.typing as npt

VERSION: str

Floats: TypeAlias = npt.NDArray[np.float64]
Ints: TypeAlias = npt.NDArray[np.int64]
Path: TypeAlias = str | PathLike[str]
CameraModel: TypeAlias = Literal[
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "EUCM",
]
"""COLMAP's name of a camera model."""

class _CameraFields(TypedDict):
    """A camera, as in PoseLib and COLMAP."""

    model: CameraModel
    width: int
    height: int
    params: npt.ArrayLike

class _CameraObject(Protocol):
    """An object such as `pycolmap.Camera`."""

    @property
    def model(self) -> Any: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def params(self) -> Any: ...

Camera: TypeAlias = _CameraFields | str | _CameraObject
"""A dictionary, `"MODEL,WIDTH,HEIGHT,PARAMS…"` (commas or spaces), or an object such as `pycolmap.Camera`."""
Scheme: TypeAlias = Literal[
    "dcl", "dcl:vertical", "dcl:horizontal", "dcl:paper", "random-lines", "coordinate-permutation", "points"
]
"""An obfuscation scheme. A layout with numbers, such as `dcl:angle=30,s=2`, needs `typing.cast`."""
Anchors: TypeAlias = Literal["world", "gravity", "image"]
Features: TypeAlias = Literal["compact", "sift"]
Focal: TypeAlias = Literal["calibrated", "exif", "unknown"]
Send: TypeAlias = Literal["matches", "explained"]
Image: TypeAlias = Path | npt.NDArray[np.uint8] | npt.NDArray[np.float32]
Mask: TypeAlias = Path | npt.NDArray[np.bool_]
Options: TypeAlias = dict[str, Any]
Progress: TypeAlias = Callable[[str, int, int], object]
Posed: TypeAlias = Path | Iterable[tuple[str, Camera, CameraPose]]
Gravity: TypeAlias = Sequence[Any]
Frames: TypeAlias = Iterable[tuple[bytes, CameraPose] | tuple[bytes, CameraPose, float, float]]

class CameraPose:
    """Pose of a camera in the world, `x_cam = R x_world + t`.

    Give a quaternion or a rotation matrix; the default is the identity.

    Args:
        q: quaternion `[w, x, y, z]`; it is normalized.
        t: translation, `[3]`, map units; zero by default.
        R: rotation matrix, `[3, 3]`, instead of `q`.

    Raises:
        InputError: a number is not finite, `q` is zero, or `R` is not a rotation.
    """

    def __init__(
        self, q: npt.ArrayLike | None = None, t: npt.ArrayLike | None = None, *, R: npt.ArrayLike | None = None
    ) -> None: ...
    @property
    def q(self) -> Floats:
        """Quaternion `[w, x, y, z]` of length 1 with `w >= 0`, `[4]`."""
    @property
    def t(self) -> Floats:
        """Translation, `[3]`, map units."""
    @property
    def R(self) -> Floats:
        """Rotation matrix, `[3, 3]`, world to camera."""
    @property
    def Rt(self) -> Floats:
        """`[R | t]`, `[3, 4]`."""
    @property
    def xyzw(self) -> Floats:
        """Quaternion `[x, y, z, w]` of length 1 with `w >= 0`, `[4]`: the order of ROS and SciPy."""
    @property
    def matrix(self) -> Floats:
        """`[R | t]` with the last row `[0, 0, 0, 1]`, `[4, 4]`, map to camera: the pose of the camera in the map is
        `pose.inverse().matrix`."""
    def inverse(self) -> CameraPose:
        """The inverse transform: of a camera's pose, the rotation and position of the camera in the map."""
    @property
    def center(self) -> Floats:
        """Camera centre, `-Rᵀ t`, `[3]`, map units."""
    def error(self, other: CameraPose) -> tuple[float, float]:
        """Errors against another pose: rotation in degrees, and distance of the centres in map units."""
    def __eq__(self, other: object) -> bool: ...

class Doubt:
    """A reason not to trust a pose."""

    @property
    def kind(self) -> str:
        """`"weak-evidence"`, `"ambiguous"`, `"imprecise"`, `"one-sided"` or `"other"`."""
    @property
    def text(self) -> str:
        """The reason, for people."""
    def __eq__(self, other: object) -> bool: ...
    def __hash__(self) -> int: ...

class Answer:
    """The pose of a sealed query, and how far it can be trusted."""

    @property
    def pose(self) -> CameraPose | None:
        """Pose in the map (of the rig, for a rig); None when it is doubtful and only a trusted pose was requested."""
    @property
    def center(self) -> Floats | None:
        """Camera centre in the map, `[3]`, map units; None without a pose."""
    @property
    def covariance(self) -> Floats | None:
        """Covariance, `[6, 6]`: rotation vector in the camera frame (radians), then translation in it (map units); None
        without a pose. Relative to the map: how well the map is placed on earth is not part of it."""
    @property
    def center_covariance(self) -> Floats | None:
        """Covariance of the centre in the map's axes, `[3, 3]`, map units squared; None without a pose."""
    @property
    def position_sd(self) -> float:
        """Standard deviation of the position in its least certain direction, map units; infinite without a pose."""
    @property
    def rotation_sd_deg(self) -> float:
        """Standard deviation of the orientation about its least certain axis, degrees; infinite without a pose."""
    @property
    def state(self) -> str:
        """`"trusted"` or `"doubtful"`."""
    @property
    def trusted(self) -> bool:
        """Whether `state` is `"trusted"`."""
    @property
    def doubts(self) -> list[Doubt]:
        """The reasons to doubt the pose; none for a trusted one."""
    @property
    def log_evidence(self) -> float:
        """Natural logarithm of the evidence for this pose over a chance agreement."""
    @property
    def margin(self) -> float:
        """Log likelihood by which the pose beats the best other one; infinite when no other was found."""
    @property
    def inliers(self) -> int:
        """Rows of the query that agree with the pose."""
    @property
    def matches(self) -> int:
        """Rows of the query that were matched."""
    @property
    def hypotheses(self) -> int:
        """RANSAC hypotheses that were scored."""
    @property
    def noise_px(self) -> float | None:
        """Standard deviation of the inliers, pixels; None when it is not known."""
    @property
    def focal_scale(self) -> float | None:
        """Estimated focal length over that of the query; 1 when it was not estimated, None when it is not known."""
    @property
    def principal_shift_px(self) -> tuple[float, float] | None:
        """Estimated principal point minus that of the query, pixels; `(0, 0)` when it was not estimated, None when it is
        not known."""
    @property
    def gravity(self) -> str | None:
        """Use of gravity: `"used"`; `"unused"` when the map has no down direction; None when the query has no gravity."""
    @property
    def metres_per_unit(self) -> float | None:
        """Metres of a unit of the map, 1; None when the unit is not known."""
    @property
    def down(self) -> Floats | None:
        """Direction of gravity in the map, `[3]`, a unit vector; None when the map does not know it."""
    @property
    def retrieved(self) -> list[str]:
        """Names of the map images that were matched, best first; empty in answers of a service."""
    @property
    def ms(self) -> dict[str, float]:
        """Milliseconds spent in `queue`, `retrieve`, `match` and `pose`."""
    @property
    def frames(self) -> list[CameraPose]:
        """The pose of each camera of a rig; empty for a single query, and in answers of a service."""
    def to_json(self) -> str:
        """The answer as JSON: the document that the service gives, and `veiloc localize --json` for each query."""
    def to_dict(self) -> dict[str, Any]:
        """The document of `to_json` as a dictionary."""
    def __bool__(self) -> bool: ...

class Alignment:
    """The transform from the map to a frame that a device tracks itself in (odometry, an AR session), from several answers.

    The last answers are compared; the largest set that agrees is averaged, and everything else moves nothing: not a wrong answer,
    and not a doubtful one. After a jump of the odometry, new answers that agree take over.

    Args:
        metres_per_unit: metres of a unit of the map. Default: as the answers state it.
        drift: standard deviation of the odometry's position after a metre of path, metres.
        rotation_drift_deg: the same of its rotation, degrees.
        position_floor: standard deviation of the position along each axis that answers of one place share, metres.
        rotation_floor_deg: the same of the rotation about each axis, degrees.

    Raises:
        InputError: a number is negative or not finite, or `metres_per_unit` is 0.
    """

    def __init__(
        self,
        *,
        metres_per_unit: float | None = None,
        drift: float = 0.01,
        rotation_drift_deg: float = 0.05,
        position_floor: float = 0.02,
        rotation_floor_deg: float = 0.2,
    ) -> None: ...
    def add(
        self, answer: Answer, cam_from_odom: CameraPose
    ) -> Literal["used", "contradicts", "doubtful-agrees", "doubtful", "no-pose", "unknown-unit"]:
        """Takes an answer, and the pose of the camera (or rig) in the odometry frame when it took the image, not its pose now.

        Args:
            answer: the answer to the sealed image.
            cam_from_odom: pose of the camera in the odometry frame, metres.

        Returns:
            What it did: `"used"`; `"contradicts"`: trusted, and contradicts the transform; `"doubtful-agrees"`, `"doubtful"`: nothing
            changed; `"no-pose"`; `"unknown-unit"`: it does not state the unit of the map, and none was given.
        """
    def moved(self, cam_from_odom: CameraPose) -> None:
        """Takes the pose of the camera in the odometry frame between answers: the length of its path says how far the odometry may have
        drifted.
        """
    def reset(self) -> None:
        """Forgets all answers, as when the odometry starts again."""
    @property
    def state(self) -> Literal["searching", "tentative", "aligned"]:
        """`"searching"`: no trusted answer yet; `"tentative"`: no two answers agree; `"aligned"`."""
    @property
    def odom_from_map(self) -> CameraPose | None:
        """`x_odom = R x_map + t`, both in metres; None before the first trusted answer."""
    @property
    def covariance(self) -> Floats | None:
        """Covariance of `odom_from_map`, `[6, 6]`: rotation vector in the odometry frame (radians), then translation in it (metres);
        None before the first trusted answer."""
    @property
    def used(self) -> int:
        """Answers that the transform is the average of."""
    @property
    def contradicting(self) -> int:
        """Trusted answers that contradict it, among those that are remembered."""
    def cam_from_map(self, cam_from_odom: CameraPose) -> CameraPose | None:
        """Pose of the camera in the map, map units, from its pose in the odometry frame now; None before the first trusted answer."""

class Profile:
    """Profile of a map: the feature type, the vocabulary and the limits with which a device seals queries.

    It holds no map data, and it cannot weaken the protection. Get one from `Map.profile`, `Client.profile`, a file
    (`Profile.open`) or bytes (`Profile.from_bytes`); `bytes(profile)` is the content of a profile file.
    """

    @staticmethod
    def open(path: Path) -> Profile:
        """Reads a profile file that `veiloc map profile` wrote.

        Raises:
            QueryError: the file cannot be read, or is not a profile.
        """
    @staticmethod
    def from_bytes(data: bytes) -> Profile:
        """Decodes a profile.

        Raises:
            QueryError: the bytes are not a profile.
        """
    @property
    def id(self) -> str:
        """Identifier of the profile. A map refuses queries that were sealed with another one."""
    @property
    def features(self) -> str:
        """Name of the local features."""
    @property
    def global_descriptor(self) -> str:
        """Name of the model that computes the global descriptor."""
    @property
    def max_keypoints(self) -> int:
        """Most keypoints that the profile requests."""
    @property
    def max_image_side(self) -> int:
        """Longest image side that the profile requests, pixels."""
    def __bytes__(self) -> bytes: ...
    def __eq__(self, other: object) -> bool: ...
    def __hash__(self) -> int: ...

class Pack:
    """Pack of a map: the descriptors of its points, image by image, without positions.

    A device that has it seals what the place knows and nothing else (`Sealer`). It shows what the place looks like, without
    where, so the operator decides who gets it. Get one from `Map.pack`, `Client.pack`, a file (`Pack.open`) or bytes
    (`Pack.from_bytes`); `bytes(pack)` is the content of a pack file.
    """

    @staticmethod
    def open(path: Path) -> Pack:
        """Reads a pack file that `veiloc map pack` wrote.

        Raises:
            QueryError: the file cannot be read, or is not a pack.
        """
    @staticmethod
    def from_bytes(data: bytes) -> Pack:
        """Decodes a pack.

        Raises:
            QueryError: the bytes are not a pack.
        """
    @property
    def id(self) -> str:
        """Identifier of the pack. A map refuses matches in another one."""
    @property
    def profile(self) -> Profile:
        """The profile of the map, for `Sealer`."""
    @property
    def points(self) -> int:
        """Number of points."""
    @property
    def images(self) -> int:
        """Number of images."""
    def __bytes__(self) -> bytes: ...
    def __eq__(self, other: object) -> bool: ...
    def __hash__(self) -> int: ...

class Extracted:
    """The features of an image with their camera, until they are sealed. `len(extracted)` is the number of keypoints."""

    def __len__(self) -> int: ...

class Sealer:
    """Seals images for one map: `extract`, then `seal`. Only the bytes of sealed queries leave the device.

    The device decides all options; a profile cannot change them.

    Args:
        profile: profile of the map.
        scheme: `"dcl"` and its layouts, `"random-lines"`, `"coordinate-permutation"`, or `"points"`, which hides
            nothing.
        max_keypoints: most keypoints to send; a query has at least 256 rows, filled up with decoys. Default: the number
            that the profile requests, at most 2048.
        max_image_side: longest side to which images are scaled down, pixels, whatever the profile requests; default
            2048. The next smaller size of the device's list is used.
        angle_bits: bits of each quantized angle.
        send_gravity: False sends no gravity direction.
        pack: pack of the map: nothing is sent that the place does not know. Default: all descriptors are sent.
        send: what is sent with a pack: `"matches"`, the points that keypoints match in the pack, and no descriptor
            (default), or `"explained"`, the descriptors that the pack explains.

    Raises:
        QueryError: the profile requests more than this device sends, the scheme is unknown, or the pack is of another map
            or too large.
        InputError: `send` is unknown, or given without a pack.
    """

    def __init__(
        self,
        profile: Profile,
        *,
        scheme: Scheme = "dcl",
        max_keypoints: int | None = None,
        max_image_side: int | None = None,
        angle_bits: int = 12,
        send_gravity: bool = True,
        pack: Pack | None = None,
        send: Send | None = None,
    ) -> None: ...
    def extract(
        self,
        image: Image,
        camera: Camera | None,
        *,
        mask: Mask | None = None,
        focal: Focal | None = None,
        gravity: npt.ArrayLike | None = None,
        orientation: npt.ArrayLike | None = None,
        down: npt.ArrayLike | None = None,
    ) -> Extracted:
        """Extracts the features of an image, as the profile requests them.

        Args:
            image: a path, or an array as for `veiloc.extract`.
            camera: a dictionary or text as for `estimate_absolute_pose`; None reads the focal length from the file's EXIF,
                `"unknown"` sends a guess, which localization corrects.
            mask: a path (black hides) or an array `[H, W]` of bool (True hides); hidden pixels are not used.
            focal: `"calibrated"`, `"exif"` or `"unknown"`. Default: follows from `camera`.
            gravity: `[x, y, z]` or `[x, y, z, degrees]`: measured down direction in the camera frame, and its standard
                deviation (2). It is sent with the query.
            orientation: quaternion `[w, x, y, z]`, rotation from a fixed world frame to the camera (gyroscope,
                odometry), for a session.
            down: `[x, y, z]`, measured down direction in the camera frame, for the session's anchors. It is sent, rounded,
                with a standard deviation of 0.5 degrees, unless `gravity` is given.

        Raises:
            ImageError: the image or the mask cannot be used.
            InputError: another argument is invalid.
        """
    def seal(self, extracted: Extracted) -> bytes:
        """Seals the features of an image on its own, once. For several images of the same scene use `in_session`.

        Randomness comes from the operating system. When the network fails, send the same bytes again.

        Returns:
            The bytes of the sealed query.

        Raises:
            Error: the image shows too little texture.
            NotThisPlaceError: hardly anything in the image is of the place of the pack.
            InputError: the features were sealed already.
        """
    def in_session(self, session: Session) -> SessionSealer:
        """For the next images of a session, which share their anchors."""

class SessionSealer:
    """A `Sealer` for the images of one session."""

    def seal(self, extracted: Extracted) -> bytes:
        """Seals the features of the next image, as `Sealer.seal`. When this fails, the session does not change.

        Returns:
            The bytes of the sealed query.

        Raises:
            Error, InputError: as for `Sealer.seal`; the session cannot go on with this image.
        """

class Session:
    """A sequence of images of one scene, sealed by `Sealer.in_session`.

    The images share their anchors, and no keypoint is sent under two anchors.

    A session holds keypoint positions: `bytes(session)` must not leave the device.

    Args:
        anchors: the frame in which the anchors are fixed: `"world"`, `"gravity"` or `"image"`.

    Raises:
        InputError: `anchors` is another string.
    """

    def __init__(self, *, anchors: Anchors = "world") -> None: ...
    @staticmethod
    def from_bytes(data: bytes) -> Session:
        """Decodes a session.

        Raises:
            Error: the bytes are not a session.
        """
    @staticmethod
    def open(path: Path) -> Session:
        """Reads a session file, also one that `veiloc seal --session` wrote.

        Raises:
            Error: the file cannot be read, or is not a session.
        """
    @property
    def frames(self) -> int:
        """Number of images that were sealed."""
    @property
    def starts(self) -> int:
        """How many times the session chose new anchors."""
    def __bytes__(self) -> bytes: ...

class Map:
    """A map, in which sealed queries are localized.

    A map is immutable: `add` and `remove` return a new one. A map that was built or changed is in memory until `save`
    writes it.
    """

    @staticmethod
    def build(
        posed: Posed,
        images: Path,
        *,
        names: Sequence[str] | None = None,
        masks: Path | None = None,
        features: Features = "compact",
        down: npt.ArrayLike | str | None = None,
        metres: bool = False,
        self_test: bool = True,
        keep_broken: bool = False,
        skip_bad: bool = False,
        other_coordinate_frame: Literal["refuse", "align", "accept"] = "refuse",
        work: Path | None = None,
        progress: Progress | None = None,
    ) -> Map:
        """Builds a map from images with known poses.

        Args:
            posed: images with cameras and poses, of any format that `read_posed` reads, or a list of (name, camera,
                CameraPose).
            images: folder of the images.
            names: use only these images, in this order.
            masks: folder of masks, `door/3.jpg.png` for `door/3.jpg` as in COLMAP: nothing of what is black gets into the map. An
                image without a mask is used as a whole.
            features: `"compact"` or `"sift"`.
            down: the down direction in the map's axes, `[x, y, z]` or a string such as `"-z"`. Default:
                that of the format of `posed`, if it defines one.
            metres: the poses are in metres. Default: if the format of `posed` defines it.
            self_test: localize some of the map's own images, to calibrate the covariances of its answers.
            keep_broken: return a map in which nothing can be localized, too.
            skip_bad: skip images that cannot be used, instead of raising an error.
            other_coordinate_frame: what to do with a group of images whose poses are in another coordinate frame than the rest: `"refuse"`,
                `"align"` (transform their poses) or `"accept"` (do not compare).
            work: folder that caches features and matches between calls. It holds keypoints and descriptors of the
                images.
            progress: a callable of (stage, done, total).

        Raises:
            ImageError: an image cannot be used.
            MapError: the model cannot be read, no map can be built from these images, or nothing can be localized in it.
        """
    @staticmethod
    def from_images(
        images: Path,
        work: Path,
        *,
        names: Sequence[str] | None = None,
        features: Features = "compact",
        down: npt.ArrayLike | str | None = None,
        self_test: bool = True,
        keep_broken: bool = False,
        skip_bad: bool = False,
        matching: Literal["auto", "exhaustive", "sequential"] = "auto",
        python: Path | None = None,
        panoramas: bool = False,
        progress: Progress | None = None,
    ) -> Map:
        """Builds a map from images without poses: pycolmap computes the poses (`pip install veiloc[sfm]`).

        The map has no metric scale. Images without a pose, and further models that are not connected, are in `warnings`.

        Args:
            images: folder of the images.
            work: folder that keeps the database and models of COLMAP, and features and matches of the map, so that an
                interrupted build continues. It holds keypoints and descriptors of the images.
            names: use only these images.
            features, down, self_test, keep_broken, skip_bad, progress: as for `build`.
            matching: `"exhaustive"` (all pairs), `"sequential"` (frames of a video) or `"auto"`.
            python: the Python that has pycolmap. Default: this one.
            panoramas: all images that are twice as wide as high are equirectangular panoramas, also if their metadata does not say so.
                Each becomes five pinhole images of the map.

        Raises:
            ImageError: an image cannot be used.
            MapError: pycolmap is not installed or fails, or no map can be built from these images.
        """
    @staticmethod
    def from_colmap(
        model: Path,
        images: Path,
        *,
        features: Features = "compact",
        down: npt.ArrayLike | str | None = None,
        metres: bool = False,
        self_test: bool = True,
        keep_broken: bool = False,
        skip_bad: bool = False,
        other_coordinate_frame: Literal["refuse", "accept"] = "refuse",
        progress: Progress | None = None,
    ) -> Map:
        """Builds a map from a complete COLMAP model; it keeps the model's points and observations.

        Args:
            model: folder of the model, text or binary.
            images, features, down, self_test, keep_broken, skip_bad, progress: as for `build`.
            metres: lengths of the model are in metres.
            other_coordinate_frame: what to do with a group of images whose poses are in another coordinate frame than the rest: `"refuse"` or
                `"accept"`. To transform it, use `build` with `other_coordinate_frame="align"`.

        Raises:
            MapError, ImageError: as for `build`.
        """
    @staticmethod
    def open(path: Path) -> Map:
        """Opens a map file.

        Raises:
            MapError: the file cannot be read, or is damaged.
        """
    def save(self, path: Path) -> None:
        """Writes the map to a file atomically: a failure leaves the old file unchanged.

        Raises:
            MapError: the file cannot be written.
        """
    def add(
        self,
        posed: Posed,
        images: Path,
        *,
        names: Sequence[str] | None = None,
        self_test: bool = True,
        keep_broken: bool = False,
        skip_bad: bool = False,
        other_coordinate_frame: Literal["refuse", "align", "accept"] = "refuse",
        progress: Progress | None = None,
    ) -> Map:
        """Returns the map with more posed images; the profile stays the same.

        Args:
            posed, images, names, self_test, keep_broken, skip_bad, progress: as for `build`; the poses are in the map's coordinate frame.
            other_coordinate_frame: as for `build`; the images are localized in the map before they are added.

        Raises:
            ImageError: an image cannot be used.
            MapError: the poses cannot be read, or an image is in the map already.
        """
    def remove(
        self,
        names: Sequence[str],
        *,
        retrain: bool = False,
        self_test: bool = True,
        keep_broken: bool = False,
        progress: Progress | None = None,
    ) -> Map:
        """Returns the map without these images, their keypoints, and the points that only they observe.

        Args:
            names: names of the images to remove.
            retrain: train the vocabulary again without them; this changes the profile.
            self_test, keep_broken, progress: as for `build`.

        Raises:
            MapError: a name is not in the map.
        """
    def self_test(
        self, *, images: int = 50, schemes: Sequence[Scheme] | None = None, progress: Progress | None = None
    ) -> dict[str, dict[str, Any]]:
        """Localizes some of the map's own images, each against the rest of the map (leave-one-out).

        Args:
            images: most images to test.
            schemes: obfuscation schemes. Default: all.
            progress: as for `build`.

        Returns:
            A dictionary for each scheme: `images`, `localized`, `trusted`, `median_rotation_deg`, `median_translation`
            (map units), `noise_px`, `factor` (multiplies covariances), `rotation_floor_deg`, `translation_floor`.

        Raises:
            MapError: no query can be sealed for the map.
        """
    def self_test_share(
        self, share: tuple[int, int], *, images: int = 50, progress: Progress | None = None
    ) -> list[Any]:
        """Runs one share of a self-test that several processes divide; `with_self_test` combines the shares.

        Args:
            share: `(i, n)`: share `i` of `n`, counted from 0.
            images: most images of the whole test.
            progress: as for `build`.

        Returns:
            A list for `with_self_test`; it can be pickled.

        Raises:
            MapError: no query can be sealed for the map.
            InputError: `share` is invalid.
        """
    def with_self_test(
        self, shares: Sequence[Sequence[Any]], *, images: int = 50, keep_broken: bool = False
    ) -> Map:
        """Returns the map with a self-test that was run in shares. The result equals that of a test in one process.

        Args:
            shares: the results of `self_test_share` for all shares, in any order.
            images: the same value as for `self_test_share`.
            keep_broken: as for `build`.

        Raises:
            MapError: nothing can be localized in the map.
            InputError: an image of the test is missing or occurs twice.
        """
    def localize(
        self,
        query: bytes,
        *,
        retrieve: int = 10,
        use_prior: bool = True,
        ransac_opt: Options | None = None,
        bundle_opt: Options | None = None,
        position: npt.ArrayLike | None = None,
    ) -> Answer:
        """Localizes a sealed query.

        Args:
            query: bytes of the sealed query.
            retrieve: number of retrieved map images to match with.
            use_prior: weight each match by its prior probability.
            ransac_opt, bundle_opt: as for `estimate_absolute_pose`, including `seed`.
            position: `(x, y, z, sd)`: approximate position of the camera and its standard deviation, map units.

        Raises:
            NotLocalizedError: the query supports no pose in this map.
            WrongProfileError: the query was sealed for another map.
            QueryError: the bytes are not a sealed query.
        """
    def localize_rig(
        self,
        frames: Frames,
        *,
        retrieve: int = 10,
        use_prior: bool = True,
        ransac_opt: Options | None = None,
        bundle_opt: Options | None = None,
        position: npt.ArrayLike | None = None,
    ) -> Answer:
        """Localizes several sealed queries of one device together, given the relative poses of their cameras (a rig).

        Args:
            frames: a list of (bytes, CameraPose, degrees, map units): the query, the camera's pose on the rig
                (`x_cam = R x_rig + t`), and the standard deviations of its rotation and position; (bytes, CameraPose)
                when the pose on the rig is exact.
            retrieve, use_prior, ransac_opt, bundle_opt, position: as for `localize`.

        Returns:
            An answer with the pose of the rig, and the poses of the cameras in `frames`.

        Raises:
            NotLocalizedError, WrongProfileError, QueryError: as for `localize`.
            InputError: `frames` is empty or invalid.
        """
    @property
    def tested(self) -> dict[str, dict[str, Any]] | None:
        """Result of the self-test that the map stores, as `self_test` returns it; None when it stores none."""
    @property
    def profile(self) -> Profile:
        """The profile of the map; a device needs it to seal queries."""
    def pack(self) -> Pack:
        """The pack of the map: what its points look like, image by image, without positions. The same map gives the same pack.

        Raises:
            QueryError: the map has no points, or more than a pack can have; give the pack of a region then.
        """
    @property
    def image_names(self) -> list[str]:
        """Names of the map's images."""
    @property
    def poses(self) -> dict[str, CameraPose]:
        """Poses of the map's images, by name."""
    @property
    def points(self) -> Floats:
        """The map's points, `[N, 3]`, map units."""
    @property
    def cameras(self) -> dict[str, _CameraFields]:
        """Cameras of the map's images, by name. Of a map from images without poses they are the estimated ones: seal queries of
        the same camera with them."""
    @property
    def is_metric(self) -> bool:
        """Whether map units are metres; False when it is not known."""
    @property
    def down(self) -> list[float] | None:
        """The down direction, `[3]`; None when it is not known."""
    @property
    def warnings(self) -> list[str]:
        """Warnings from when the map was built or changed."""
    def __len__(self) -> int:
        """Number of images."""
    def _repr_svg_(self) -> str | None:
        """Top view of the map for notebooks: its points and the cameras of its images."""

def read_posed(path: Path, images: Path | None = None) -> tuple[list[tuple[str, _CameraFields, CameraPose]], dict[str, Any]]:
    """Reads images with cameras and poses: a COLMAP model, or a file or folder of nerfstudio, Bundler, VisualSFM, OpenSfM,
    Metashape, RealityCapture, kapture, Polycam, Record3D, 3D Scanner App, TUM, KITTI or EuRoC. The format is recognized.

    Args:
        path: the file or folder.
        images: folder of the images: names are relative to it, and it has the sizes of images that a format does not
            have. Default: the folder of `path`.

    Returns:
        A list of (name, camera, CameraPose), as `Map.build` takes it, and a dictionary: `format`; `path`, the file that was
        read; `down`, the direction of gravity that the format defines, or None; `is_metric`, whether it defines that lengths are
        metres; `remarks`, what was left out or assumed.

    Raises:
        MapError: no format is recognized, several are, or the file cannot be read.
    """

def prepare(
    posed: Posed,
    images: Path,
    work: Path,
    stage: str,
    share: tuple[int, int],
    *,
    names: Sequence[str] | None = None,
    features: Features = "compact",
    skip_bad: bool = False,
    progress: Progress | None = None,
) -> tuple[int, int]:
    """Computes one share of the intermediate results of `Map.build`, and caches it in the folder `work`.

    `Map.build` with the same arguments and `work` then reads the cache, and computes what is missing. The stages
    `"features"`, `"first-pairs"` and `"pairs"` run in this order; each needs all shares of the stage before it.

    Args:
        posed, images, names, features, skip_bad, progress: as for `Map.build`.
        work: folder of the cache; several processes may write to it at once. It holds keypoints and descriptors of the
            images.
        stage: `"features"`, `"first-pairs"` or `"pairs"`.
        share: `(i, n)`: share `i` of `n`, counted from 0.

    Returns:
        The number of images or pairs in this share, and in all shares.

    Raises:
        MapError, ImageError: as for `Map.build`.
        InputError: `stage` or `share` is invalid.
    """

class Client:
    """A client of a localization service. It sends sealed queries and nothing else; a retry sends the same bytes.

    Args:
        server: address of the service, `https://…`; plain `http://` only for this machine.
        token: bearer token, if the service requires one.
        certificates: CA certificates to trust in addition to the system's, PEM, bytes.
        insecure_http: allow plain HTTP to other machines.
        timeout: most seconds to wait for an answer.
        retries: how many times to retry when the service is busy or the network fails.
        cache: folder in which profiles and packs are cached.
        profile_ids: dictionary from names of maps to the ids of their profiles, as their operator publishes them; a map
            with another profile is an error. Default: any profile.
        pack_ids: the same for packs.

    Raises:
        ServiceError: the address, the token or the certificates cannot be used.
    """

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
        profile_ids: dict[str, str] | None = None,
        pack_ids: dict[str, str] | None = None,
    ) -> None: ...
    def profile(self, map: str) -> Profile:
        """Fetches the profile of a map of the service; a `Sealer` needs it.

        Raises:
            ServiceError: the service refused the request, cannot be reached, or has another profile than `profile_ids`.
        """
    def pack(self, map: str) -> Pack:
        """Fetches the pack of a map of the service, for a `Sealer` that sends only what the place knows. It contains the
        profile.

        Raises:
            RefusedError: the operator gives no packs, or the service refused the request.
            ServiceError: the service cannot be reached, or has another pack than `pack_ids`.
        """
    def anchors(self, map: str, *, near: npt.ArrayLike | None = None) -> list[dict[str, Any]]:
        """Fetches all content anchors of a map.

        Args:
            map: name of the map at the service.
            near: `(x, y, z)`: a place in the map; the nearest anchor comes first, and each has its `distance` from there, map
                units. The service does not learn it.

        Returns:
            Dictionaries with `name`, `map_from_anchor` (`q`: w, x, y, z, and `t`), `content`, and `owner` of own anchors.

        Raises:
            RefusedError: the service refused the request.
            ServiceError: the service cannot be reached, or its answer cannot be read.
        """
    def put_anchor(
        self, map: str, name: str, *, q: npt.ArrayLike, t: npt.ArrayLike, content: Any = None
    ) -> None:
        """Writes a content anchor: a new one, or one that the token owns. The last writer wins.

        Args:
            map: name of the map at the service.
            name: of the anchor: letters, digits, `-`, `_` and `.`.
            q: quaternion w, x, y, z from the content's axes to the map's.
            t: position in the map, map units.
            content: what `json.dumps` takes, at most 4096 bytes.

        Raises:
            InputError: no service takes this anchor; nothing was sent.
            RefusedError: the token lacks the permission `anchors`, or another token owns the anchor.
            ServiceError: the service cannot be reached.
        """
    def delete_anchor(self, map: str, name: str) -> None:
        """Deletes a content anchor that the token owns.

        Raises:
            InputError, RefusedError, ServiceError: as for `put_anchor`.
        """
    def localize(
        self, map: str, query: bytes, *, trusted_only: bool = False, near: npt.ArrayLike | None = None
    ) -> Answer:
        """Localizes a sealed query at the service.

        Args:
            map: name of the map at the service.
            query: bytes of the sealed query.
            trusted_only: return no pose when it is doubtful.
            near: `(x, y, z, sd)`: approximate position of the camera and its standard deviation, map units. The service
                learns this position.

        Raises:
            NotLocalizedError: the service found no pose.
            WrongProfileError: the query was sealed for another map.
            BusyError: the service is busy.
            RefusedError: the service refused the request.
            ServiceError: the service cannot be reached, or its answer cannot be read.
        """
    def localize_progressive(
        self,
        map: str,
        query: bytes,
        profile: Profile,
        *,
        position_sd: float | None = None,
        trusted_only: bool = False,
        near: npt.ArrayLike | None = None,
    ) -> tuple[Answer, list[dict[str, Any]]]:
        """Localizes in steps, and stops sending rows as soon as the pose is trusted.

        Args:
            map, query, trusted_only, near: as for `localize`.
            profile: the profile with which the query was sealed.
            position_sd: stop only when the standard deviation of the position is below this, map units. Default: stop
                at the first trusted pose.

        Returns:
            The answer, and a dictionary with `rows`, `bytes` and `outcome` for each step.

        Raises:
            NotLocalizedError, WrongProfileError, BusyError, RefusedError, ServiceError: as for `localize`.
        """
    def localize_rig(
        self, map: str, frames: Frames, *, trusted_only: bool = False, near: npt.ArrayLike | None = None
    ) -> Answer:
        """Localizes several images of one device together. They must be sealed in one session (`Sealer.in_session`): two lines of a
        keypoint from separate seals would cross in it.

        Args:
            frames: as for `Map.localize_rig`.
            map, trusted_only, near: as for `localize`.

        Raises:
            InputError: the frames are not of one session; nothing was sent.
            NotLocalizedError, WrongProfileError, BusyError, RefusedError, ServiceError: as for `localize`.
        """

class ColmapModel:
    """A COLMAP model, text or binary."""

    @staticmethod
    def open(folder: Path) -> ColmapModel:
        """Reads the model in a folder.

        Raises:
            MapError: the model cannot be read.
        """
    @property
    def image_names(self) -> list[str]:
        """Names of the images."""
    def pose(self, name: str) -> CameraPose | None:
        """Pose of an image; None when the model has no image of this name."""
    def camera(self, name: str) -> _CameraFields | None:
        """Camera of an image, a dictionary; None when the model has no image of this name."""
    def point_rows(self, name: str) -> Ints | None:
        """Row in `points` of the point that each keypoint of an image observes, `[N]` int64, -1 for none; None when the
        model has no image of this name.
        """
    @property
    def points(self) -> Floats:
        """The 3D points, `[N, 3]`, map units."""
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
    focal: Focal = "calibrated",
) -> tuple[CameraPose, dict[str, Any]]:
    """Estimates the pose of a camera from 2D–3D point correspondences.

    Args:
        points2d: `[N, 2]` pixels of the distorted image (the centre of its first pixel is (0.5, 0.5)).
        points3d: `[N, 3]` map units.
        camera: `{"model", "width", "height", "params"}` with COLMAP's models, or `"MODEL,WIDTH,HEIGHT,PARAMS…"`.
        ransac_opt: `max_iterations` (10000), `min_iterations` (200), `success_prob` (0.9999), `seed` (0),
            `score` (`"likelihood"` or `"msac"`), `max_reproj_error` (pixels, 4; only with `"msac"`), `noise_px`
            (pixels, 2; only with `"likelihood"`), `expected_inlier_ratio` (0.2), `fixed_iterations` (none),
            `min_inliers` (10), `anchored_solver`.
        bundle_opt: `estimate_noise` (True): estimate the noise from the inliers in the final refinement.
        keypoints: `[N]` keypoint indices; give several correspondences of one keypoint the same index. Default: all
            differ.
        prior: `[N]` prior probabilities that a correspondence is right. Default: all equal.
        gravity: `(down_in_camera [3], down_in_world [3])`, optionally with a standard deviation in degrees (2).
        position: `(x, y, z, sd)`: approximate position of the camera and its standard deviation, map units.
        focal: `"calibrated"`, `"exif"` or `"unknown"`: how well the focal length is known; it is estimated unless
            calibrated.

    Returns:
        The pose and a dictionary: `inliers` `[N]` bool, `num_inliers`, `num_inlier_keypoints`, `inlier_ratio`,
        `iterations`, `refinements`, `model_score` (lower is better), `noise_px`, `focal_scale`, `covariance` `[6, 6]`
        (radians, then map units), `center_covariance` `[3, 3]`, `free_direction` (`[3]`, in which the position is
        undetermined, else None), `state` (`"trusted"`, `"doubtful"` or `"not-found"`), `doubts`, `log_evidence`.

    Raises:
        InputError: a shape, a number or an option is invalid.
        NotLocalizedError: the correspondences support no pose.
    """
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
    focal: Focal = "calibrated",
) -> tuple[CameraPose, dict[str, Any]]:
    """Estimates the pose of a camera from 2D-line–3D-point correspondences.

    Each line runs through the keypoint of its map point.

    Args:
        lines2d: `[N, 3]`, `a u + b v + c = 0` in pixels of the undistorted image, of any scale.
        points3d, camera, ransac_opt, bundle_opt, keypoints, prior, gravity, position, focal: as for
            `estimate_absolute_pose`.

    Returns:
        The pose and a dictionary, as for `estimate_absolute_pose`.

    Raises:
        InputError: a shape, a number or an option is invalid.
        NotLocalizedError: the correspondences support no pose.
    """
def estimate_absolute_pose_anchored(
    anchors: npt.ArrayLike,
    angles: npt.ArrayLike,
    points3d: npt.ArrayLike,
    camera: Camera,
    ransac_opt: Options | None = None,
    bundle_opt: Options | None = None,
    *,
    layout: Scheme = "dcl",
    layout_focal: float | None = None,
    keypoints: npt.ArrayLike | None = None,
    prior: npt.ArrayLike | None = None,
    gravity: Gravity | None = None,
    position: npt.ArrayLike | None = None,
    focal: Focal = "calibrated",
) -> tuple[CameraPose, dict[str, Any]]:
    """Estimates the pose of a camera from anchored lines (Dual Convergent Lines) and map points.

    Each line runs through the keypoint of its map point.

    Args:
        anchors: `[N]`, index of each line's anchor, from 0.
        angles: `[N]` radians, direction of each line at its anchor, as `anchored_lines` returns it.
        points3d, camera, ransac_opt, bundle_opt, keypoints, prior, gravity, position, focal: as for
            `estimate_absolute_pose`.
        layout: `"dcl"` or `"dcl:..."`, the name of a scheme.
        layout_focal: focal length of the layout, pixels, as `obfuscate` returns it. Default: the camera's.

    Returns:
        The pose and a dictionary, as for `estimate_absolute_pose`.

    Raises:
        InputError: a shape, a number or an option is invalid.
        NotLocalizedError: the correspondences support no pose.
    """
def anchored_lines(points2d: npt.ArrayLike, camera: Camera, layout: Scheme = "dcl") -> tuple[Ints, Floats]:
    """Anchor and unquantized angle of each keypoint under a layout of Dual Convergent Lines.

    Args:
        points2d: `[N, 2]` pixels of the distorted image.
        camera: as for `estimate_absolute_pose`.
        layout: `"dcl"` or `"dcl:..."`.

    Returns:
        `anchors` `[N]` (int64) and `angles` `[N]` radians in [0, 2π).

    Raises:
        InputError: a shape, a number or the layout is invalid.
    """
def cropped_camera(camera: Camera, x: int, y: int, width: int, height: int) -> _CameraFields:
    """The camera of a part of an image, with its first pixel at column `x`, row `y`: for passthrough cameras of headsets,
    whose smaller images are parts of the sensor's.

    Raises:
        InputError: the part is empty or not within the image, or the camera is invalid.
    """
def undistort(points2d: npt.ArrayLike, camera: Camera) -> Floats:
    """Undistorts pixels, `[N, 2]`: their positions in the image of the same camera without distortion.

    Raises:
        InputError: a pixel has no undistorted position.
    """
def p3p(bearings: npt.ArrayLike, points3d: npt.ArrayLike) -> list[CameraPose]:
    """Poses from three points (P3P).

    Args:
        bearings: `[3, 3]`, directions of the points in the camera frame, of any length.
        points3d: `[3, 3]`, map units.

    Returns:
        At most 4 poses.
    """
def p6lp(lines: npt.ArrayLike, points3d: npt.ArrayLike) -> list[CameraPose]:
    """Poses from six lines of the image and the points on them.

    Args:
        lines: `[6, 3]`, lines of the plane z = 1 (`Kᵀ l` for a line `l` in pixels), of any scale.
        points3d: `[6, 3]`, map units.

    Returns:
        At most 8 poses.
    """
def p5lp_radial(directions: npt.ArrayLike, points3d: npt.ArrayLike) -> list[CameraPose]:
    """Poses from five half-lines with a common start in the image, up to the depth along its ray.

    Args:
        directions: `[5, 2]`, directions of the half-lines in a camera whose z axis is the common ray.
        points3d: `[5, 3]`, map units.

    Returns:
        At most 4 poses, with `t[2] = 0`.
    """
def p6lp_dual_radial(
    anchor: npt.ArrayLike,
    inward: npt.ArrayLike,
    sixth_axis: npt.ArrayLike,
    sixth_inward: npt.ArrayLike,
    points3d: npt.ArrayLike,
) -> list[CameraPose]:
    """Poses from five half-planes of one anchor and one half-plane of another anchor.

    All directions are in the camera frame, of any length.

    Args:
        anchor: `[3]`, direction of the anchor that five half-planes share.
        inward: `[5, 3]`, direction of each half-plane at the anchor.
        sixth_axis, sixth_inward: `[3]`, the same two directions for the sixth half-plane.
        points3d: `[6, 3]`, map units.

    Returns:
        At most 4 poses.
    """
def up2p(
    bearings: npt.ArrayLike,
    points3d: npt.ArrayLike,
    down_in_camera: npt.ArrayLike | None = None,
    down_in_world: npt.ArrayLike | None = None,
) -> list[CameraPose]:
    """Poses from two points and a known vertical (upright P2P).

    Args:
        bearings: `[2, 3]`, directions of the points in the camera frame, of any length.
        points3d: `[2, 3]`, map units.
        down_in_camera, down_in_world: `[3]`, the vertical in both frames. Default: the second axis of each.

    Returns:
        At most 2 poses.
    """
def u4lp(
    lines: npt.ArrayLike,
    points3d: npt.ArrayLike,
    down_in_camera: npt.ArrayLike | None = None,
    down_in_world: npt.ArrayLike | None = None,
) -> list[CameraPose]:
    """Poses from four lines and a known vertical.

    Args:
        lines: `[4, 3]`, as for `p6lp`.
        points3d: `[4, 3]`, map units.
        down_in_camera, down_in_world: `[3]`, the vertical in both frames. Default: the second axis of each.

    Returns:
        At most 2 poses.
    """
def extract(
    image: Image,
    *,
    features: Features = "compact",
    max_keypoints: int = 2048,
    max_image_side: int = 2048,
    mask: Mask | None = None,
) -> dict[str, Any]:
    """Keypoints and descriptors of an image.

    Args:
        image: a path, or an array `[H, W]` or `[H, W, 3]` of uint8 (red, green, blue), or `[H, W]` of float32 (0 to 1).
        features: `"compact"` or `"sift"`.
        max_keypoints: most keypoints to return, strongest first.
        max_image_side: larger images are scaled down to this side first, pixels.
        mask: a path (black hides) or an array `[H, W]` of bool (True hides); hidden pixels are not used.

    Returns:
        `keypoints` `[N, 2]` pixels (the first pixel's centre is (0.5, 0.5)), `descriptors` `[N, D]` uint8, `scales`
        `[N]` pixels, `orientations` `[N]` radians, `responses` `[N]`, `image_size` `[2]` (width, height).

    Raises:
        ImageError: the image or the mask cannot be used, or `features` is unknown.
    """
def people_mask(image: Path | npt.NDArray[np.uint8], network: Path, *, margin: float = 0.02) -> npt.NDArray[np.bool_] | None:
    """The people of an image, for `mask=` of `extract` and `Sealer.extract`.

    Args:
        image: a path, or an array `[H, W, 3]` of uint8 (red, green, blue), upright.
        network: path of `selfie_segmentation.tflite` of MediaPipe (Apache-2.0, in the npm package
            `@mediapipe/selfie_segmentation`); veiloc includes none.
        margin: how far beyond the people is hidden, too, as a share of the image.

    Returns:
        `[H, W]` bool, True where a person was found, or `None` when nobody was. What the network misses is not hidden.

    Raises:
        InputError: the image is of another kind.
        ImageError: the image or the network cannot be used, or the people fill the whole image.
    """
def obfuscate(
    points2d: npt.ArrayLike, width: int, height: int, scheme: Scheme = "dcl", *, angle_bits: int = 12, seed: int = 0
) -> dict[str, Any]:
    """Obfuscates keypoints under a scheme, in their order. For experiments only; a device has a `Sealer`.

    Args:
        points2d: `[N, 2]` pixels of an image without distortion.
        width, height: size of the image, pixels.
        scheme: `"dcl"` (and its layouts), `"random-lines"`, `"coordinate-permutation"`, or `"points"`, which hides
            nothing.
        angle_bits: bits of each quantized angle.
        seed: seed of the random generator.

    Returns:
        A dictionary with `kind` and its arrays: `"anchored"` with `anchors` `[N]`, `angles` `[N]` and `layout_focal`;
        `"lines"` with `lines` `[N, 3]`; `"either"` with `lines` `[N, 2, 3]`, one of the two is right; `"points"` with
        `points` `[N, 2]`.

    Raises:
        QueryError: the scheme is unknown, or a point is not finite.
    """
def describe_query(query: bytes) -> dict[str, Any]:
    """Reads the header of a sealed query: scheme, rows, bytes, profile, pack, camera size; no keypoints and no descriptors.

    `pack` is the id of the pack in which the query sends matches; None for a query with descriptors.

    Raises:
        QueryError: the bytes are not a sealed query.
    """
def device_limits() -> dict[str, int]:
    """Upper limits that this device applies to what a profile requests."""
def attack_names() -> list[str]:
    """Names of all attacks, weakest first."""
def attack(
    images: Sequence[Path],
    *,
    attacks: Sequence[str] | None = None,
    schemes: Sequence[Scheme] | None = None,
    features: Features = "compact",
    max_keypoints: int = 2048,
    max_image_side: int = 1600,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Attacks the queries of the given images under each scheme, and measures the distance to the true keypoints.

    Args:
        images: paths.
        attacks: names from `attack_names()`. Default: the attacks of the paper.
        schemes: obfuscation schemes. Default: all.
        features, max_keypoints, max_image_side: as for `extract`.
        seed: for the obfuscation and the attacks' starting points.
        progress: a callable of (stage, done, total).

    Returns:
        The report of `veiloc attack --json`.

    Raises:
        ImageError: an image cannot be used.
        InputError: an unknown attack or scheme.
        Error: an attack needs more than images.
    """
def audit(
    images: Sequence[Path],
    *,
    attacks: Sequence[str] | None = None,
    schemes: Sequence[Scheme] | None = None,
    features: Features = "compact",
    max_keypoints: int = 2048,
    max_image_side: int = 1600,
    seed: int = 0,
    synthetic: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Attacks the queries of the given images, and finds the strongest attack on each scheme.

    Args:
        images, attacks, schemes, features, max_keypoints, max_image_side, seed, progress: as for `attack`.
        synthetic: number of keypoints of the paper's synthetic scene, 0 for none.

    Returns:
        The report of `veiloc audit --json`; each part lists its strongest attacks under `strongest`.

    Raises:
        ImageError, InputError, Error: as for `attack`.
    """
def render_room(
    folder: Path, *, mapped: int = 10, queries: int = 3, seed: int = 11, panorama_width: int | None = None
) -> tuple[list[tuple[str, str, CameraPose]], list[tuple[str, str, CameraPose]]]:
    """Renders images of a synthetic room into a folder.

    Args:
        folder: folder for the images; it must exist.
        mapped, queries: number of images for the map (at most 30) and for queries (at most 9).
        seed: seed of the room; equal seeds give equal rooms.
        panorama_width: render equirectangular panoramas of this width, even and at least 256; the camera is then
            `EQUIRECTANGULAR,W,H`, and the pose that of the panorama's frame (x right, y down, z to its middle). Default: images of a
            pinhole camera.

    Returns:
        Two lists of (name, camera, CameraPose) for `Map.build`: images for the map, and images for queries. Units are
        metres.

    Raises:
        Error: an image cannot be written.
        InputError: `mapped` or `queries` is too large, or `panorama_width` is none.
    """
def run_program(command_line: Sequence[str]) -> int:
    """Runs the program and returns its exit code. Ctrl-C ends the process.

    Args:
        command_line: the program's name, then its arguments.
    """
