//! Where a map is on Earth, and poses told as OGC GeoPose.
//!
//! A map's own frame is whatever its builder chose. A [`GeoFrame`] ties it to WGS 84: the place of its origin, how its
//! axes are turned against east, north and up there, and how many metres its unit has.
//!
//! # Source
//! OGC 21-056r11, *GeoPose 1.0 Data Exchange Standard*, Basic-Quaternion; geodetic coordinates from Earth-centred ones
//! by fixed-point iteration on the latitude, as in Hofmann-Wellenhof et al., *GPS: Theory and Practice*.

use std::str::FromStr;

use serde::Serialize;
use utoipa::ToSchema;
use veiloc_geometry::nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use veiloc_protocol::{Answer, AnswerPose};

/// Semi-major axis of WGS 84, metres.
const A: f64 = 6_378_137.0;
/// Square of its first eccentricity.
const E2: f64 = 6.694_379_990_141_316e-3;

/// How a map lies on Earth.
#[derive(Debug, Clone, PartialEq)]
pub struct GeoFrame {
    latitude: f64,
    longitude: f64,
    height: f64,
    enu_from_map: UnitQuaternion<f64>,
    metres: f64,
}

/// Numbers that are no place, no rotation or no scale.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{reason}; LAT,LON,HEIGHT,QW,QX,QY,QZ[,METRES] is expected: degrees, metres above the WGS 84 ellipsoid, the \
     quaternion that turns map axes into east, north, up, and metres a map unit (1)"
)]
pub struct BadGeoFrame {
    reason: String,
}

impl FromStr for GeoFrame {
    type Err = BadGeoFrame;

    fn from_str(text: &str) -> Result<Self, BadGeoFrame> {
        let bad = |reason: &str| BadGeoFrame { reason: reason.to_owned() };
        let numbers: Vec<f64> = text
            .split(',')
            .map(|word| word.trim().parse::<f64>().ok().filter(|n| n.is_finite()))
            .collect::<Option<_>>()
            .ok_or_else(|| bad("not all are numbers"))?;
        let (latitude, longitude, height, q, metres) = match numbers[..] {
            [lat, lon, h, w, x, y, z] => (lat, lon, h, [w, x, y, z], 1.0),
            [lat, lon, h, w, x, y, z, metres] => (lat, lon, h, [w, x, y, z], metres),
            _ => return Err(bad("seven or eight numbers are needed")),
        };
        if !(-90.0..=90.0).contains(&latitude) || !(-180.0..=180.0).contains(&longitude) {
            return Err(bad("latitude from -90 to 90, longitude from -180 to 180"));
        }
        let quaternion = Quaternion::new(q[0], q[1], q[2], q[3]);
        if (quaternion.norm() - 1.0).abs() > 1e-3 {
            return Err(bad("the quaternion's length is not 1"));
        }
        if metres <= 0.0 {
            return Err(bad("the unit's length is not above 0"));
        }
        let enu_from_map = UnitQuaternion::from_quaternion(quaternion);
        Ok(Self {
            latitude: latitude.to_radians(),
            longitude: longitude.to_radians(),
            height,
            enu_from_map,
            metres,
        })
    }
}

impl GeoFrame {
    /// An answer as a GeoPose; without the pose when that is withheld.
    pub fn geo_pose(&self, answer: &Answer) -> GeoPoseDocument {
        let told = answer.pose.as_ref().map(|pose| self.on_earth(pose));
        let (position, quaternion, accuracy) = match told {
            Some((position, quaternion, accuracy)) => (Some(position), Some(quaternion), Some(accuracy)),
            None => (None, None, None),
        };
        let state = answer.state().name();
        GeoPoseDocument { position, quaternion, accuracy, state, trusted: answer.trusted }
    }

    fn on_earth(&self, pose: &AnswerPose) -> (GeoPosition, GeoQuaternion, GeoAccuracy) {
        let [w, x, y, z] = pose.rotation;
        let map_from_camera = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).inverse();
        let enu = self.enu_from_map * (Vector3::from(pose.center) * self.metres);
        let earth_from_origin = earth_from_enu(self.latitude, self.longitude);
        let earth = earth_from_geodetic(self.latitude, self.longitude, self.height) + earth_from_origin * enu;
        let (latitude, longitude, h) = geodetic_from_earth(&earth);

        // East, north and up are those of the camera's own place, not of the map's origin.
        let enu_from_map = earth_from_enu(latitude, longitude).transpose()
            * earth_from_origin
            * self.enu_from_map.to_rotation_matrix().matrix();
        let enu_from_camera = enu_from_map * map_from_camera.to_rotation_matrix().matrix();
        let q = UnitQuaternion::from_matrix(&enu_from_camera);

        let covariance = Matrix3::from_fn(|i, j| pose.center_covariance[i][j]);
        let covariance = if covariance.iter().all(|c| c.is_finite()) {
            enu_from_map * covariance * enu_from_map.transpose() * self.metres.powi(2)
        } else {
            covariance
        };
        let rotation: f64 = (0..3).map(|i| pose.covariance[i][i]).sum();
        let accuracy = GeoAccuracy {
            horizontal: (covariance[(0, 0)] + covariance[(1, 1)]).sqrt(),
            vertical: covariance[(2, 2)].sqrt(),
            orientation: rotation.sqrt().to_degrees(),
        };
        (
            GeoPosition { lat: latitude.to_degrees(), lon: longitude.to_degrees(), h },
            GeoQuaternion { x: q.i, y: q.j, z: q.k, w: q.w },
            accuracy,
        )
    }
}

/// OGC GeoPose, Basic-Quaternion (the permissive form: with members of our own).
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct GeoPoseDocument {
    /// Where the camera is; this, `quaternion` and `accuracy` are absent when a doubtful pose was asked to be withheld.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<GeoPosition>,
    /// Turns the camera's axes (`x` right, `y` down, `z` forward) into east, north, up at its place.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quaternion: Option<GeoQuaternion>,
    /// Standard deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<GeoAccuracy>,
    /// `trusted` or `doubtful`.
    pub state: &'static str,
    /// Whether nothing speaks against the pose.
    pub trusted: bool,
}

/// WGS 84.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct GeoPosition {
    /// Latitude, degrees.
    pub lat: f64,
    /// Longitude, degrees.
    pub lon: f64,
    /// Height above the ellipsoid, metres.
    pub h: f64,
}

/// A unit quaternion.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct GeoQuaternion {
    /// First imaginary part.
    pub x: f64,
    /// Second imaginary part.
    pub y: f64,
    /// Third imaginary part.
    pub z: f64,
    /// Real part.
    pub w: f64,
}

/// Standard deviations; `null` where the matches leave a direction free.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct GeoAccuracy {
    /// Of the position along the ground (root of the sum of both variances), metres.
    #[schema(value_type = Option<f64>)]
    pub horizontal: f64,
    /// Of the height, metres.
    #[schema(value_type = Option<f64>)]
    pub vertical: f64,
    /// Of the orientation (root of the sum about all axes), degrees.
    #[schema(value_type = Option<f64>)]
    pub orientation: f64,
}

/// Columns: east, north, up at this place, in Earth-centred axes.
fn earth_from_enu(latitude: f64, longitude: f64) -> Matrix3<f64> {
    let ((sp, cp), (sl, cl)) = (latitude.sin_cos(), longitude.sin_cos());
    Matrix3::new(-sl, -sp * cl, cp * cl, cl, -sp * sl, cp * sl, 0.0, cp, sp)
}

/// Radians and metres to metres from the centre of the Earth.
fn earth_from_geodetic(latitude: f64, longitude: f64, height: f64) -> Vector3<f64> {
    let ((sp, cp), (sl, cl)) = (latitude.sin_cos(), longitude.sin_cos());
    let n = A / (1.0 - E2 * sp * sp).sqrt();
    Vector3::new((n + height) * cp * cl, (n + height) * cp * sl, (n * (1.0 - E2) + height) * sp)
}

/// The way back. Each step gains nearly three digits near the ground; ten are more than a number holds.
fn geodetic_from_earth(earth: &Vector3<f64>) -> (f64, f64, f64) {
    let p = earth.x.hypot(earth.y);
    let mut latitude = earth.z.atan2(p * (1.0 - E2));
    for _ in 0..10 {
        let s = latitude.sin();
        let n = A / (1.0 - E2 * s * s).sqrt();
        latitude = (earth.z + E2 * n * s).atan2(p);
    }
    let (s, c) = latitude.sin_cos();
    // Exact at the equator and at the poles alike, unlike `p / cos`.
    let height = p * c + earth.z * s - A * (1.0 - E2 * s * s).sqrt();
    (latitude, earth.y.atan2(earth.x), height)
}

#[cfg(test)]
mod tests {
    use veiloc_protocol::AnswerTimes;

    use super::*;

    fn answer(center: [f64; 3], rotation: [f64; 4]) -> Answer {
        let q = UnitQuaternion::from_quaternion(Quaternion::new(
            rotation[0],
            rotation[1],
            rotation[2],
            rotation[3],
        ));
        let t = -(q * Vector3::from(center));
        let variance =
            |i: usize, j: usize| if i == j { [4e-6, 9e-6, 3e-6, 0.01, 0.02, 0.03][i] } else { 0.0 };
        Answer {
            pose: Some(AnswerPose {
                rotation: [q.w, q.i, q.j, q.k],
                translation: t.into(),
                center,
                covariance: std::array::from_fn(|i| std::array::from_fn(|j| variance(i, j))),
                center_covariance: [[0.0009, 0.0, 0.0], [0.0, 0.0016, 0.0], [0.0, 0.0, 0.0004]],
            }),
            trusted: true,
            doubts: Vec::new(),
            log_evidence: 100.0,
            margin: 50.0,
            fit: None,
            inliers: 1,
            matches: 1,
            hypotheses: 1,
            times: AnswerTimes::default(),
        }
    }

    /// Frame, camera centre and rotation in the map, and what pyproj makes of them (`scripts/service_geo_oracle.py`):
    /// latitude, longitude, height, and the matrix that turns camera axes into east, north, up.
    type Case = (&'static str, [f64; 3], [f64; 4], [f64; 3], [[f64; 3]; 3]);
    const ORACLE: [Case; 5] = [
        (
            "48.8583701,2.2944813,85,1,0,0,0",
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0, 0.0],
            [48.85837010000001, 2.2944813, 85.00000000093132],
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        ),
        (
            "48.8583701,2.2944813,85,0.5,-0.5,0.5,0.5,2.5",
            [120.0, -40.0, 15.0],
            [0.9, 0.1, -0.3, 0.2],
            [48.85870731232434, 2.295844142028228, -214.99910718016326],
            [
                [0.4421072, -0.8947376, -0.0631342],
                [-0.5263194, -0.3157716, 0.7894784],
                [-0.726312, -0.3158053, -0.6105227],
            ],
        ),
        (
            "-33.85,151.2,30,0.825136997,0.2062842493,0.1031421246,-0.5157106231",
            [3000.0, 4000.0, -20.0],
            [0.3, -0.7, 0.2, 0.5],
            [-33.85796466894765, 151.25312287115742, -198.68430354632437],
            [
                [-0.4176452, -0.6466571, -0.6382845],
                [-0.2272885, -0.6057966, 0.7624634],
                [-0.8797229, 0.4635139, 0.1060302],
            ],
        ),
        (
            "0,179.9999,0,1,0,0,0",
            [500.0, 0.0, 0.0],
            [1.0, 0.0, 0.0, 0.0],
            [0.0, -179.9956084235886, 0.019598200917243958],
            [[1.0, 0.0, -7.84e-5], [0.0, 1.0, 0.0], [7.84e-5, 0.0, 1.0]],
        ),
        (
            "89.5,10,10,1,0,0,0",
            [10.0, 30000.0, 0.0],
            [1.0, 0.0, 0.0, 0.0],
            [89.76858873205023, 10.022166857563896, 80.31651382427663],
            [
                [0.9999999, 0.0003869, -3.4e-6],
                [-0.0003869, 0.9999889, -0.0046877],
                [1.6e-6, 0.0046877, 0.999989],
            ],
        ),
    ];

    #[test]
    fn poses_are_where_pyproj_has_them() {
        for (frame, center, rotation, position, axes) in ORACLE {
            let frame: GeoFrame = frame.parse().expect("a frame");
            let told = frame.geo_pose(&answer(center, rotation));
            let GeoPosition { lat, lon, h } = told.position.expect("told");
            // A hundred-millionth of a degree is a millimetre.
            assert!((lat - position[0]).abs() < 1e-8 && (lon - position[1]).abs() < 1e-8, "{lat} {lon}");
            assert!((h - position[2]).abs() < 1e-3, "{h}");
            let GeoQuaternion { x, y, z, w } = told.quaternion.expect("told");
            let matrix = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
            for (i, row) in axes.iter().enumerate() {
                for (j, expected) in row.iter().enumerate() {
                    assert!((matrix.matrix()[(i, j)] - expected).abs() < 1e-6, "[{i}][{j}]");
                }
            }
        }
    }

    #[test]
    fn accuracy_is_in_metres_and_degrees() {
        let frame: GeoFrame = "10,20,0,1,0,0,0,10".parse().expect("a frame");
        let told = frame.geo_pose(&answer([0.0; 3], [1.0, 0.0, 0.0, 0.0])).accuracy.expect("told");
        assert!(
            (told.horizontal - 0.5).abs() < 1e-9,
            "10 metres times √(0.03² + 0.04²): {}",
            told.horizontal
        );
        assert!((told.vertical - 0.2).abs() < 1e-9, "{}", told.vertical);
        assert!((told.orientation - 4e-3_f64.to_degrees()).abs() < 1e-9, "√16e-6: {}", told.orientation);
        // A map on its side: its third axis points east.
        let frame: GeoFrame = "10,20,0,0.5,0.5,0.5,0.5".parse().expect("a frame");
        let told = frame.geo_pose(&answer([0.0; 3], [1.0, 0.0, 0.0, 0.0])).accuracy.expect("told");
        assert!((told.vertical - 0.04).abs() < 1e-9, "{}", told.vertical);
        let mut free = answer([0.0; 3], [1.0, 0.0, 0.0, 0.0]);
        let inf = f64::INFINITY;
        let pose = free.pose.as_mut().expect("a pose");
        pose.center_covariance = [[inf, 0.0, 0.0], [0.0, inf, 0.0], [0.0, 0.0, inf]];
        let told = serde_json::to_value(frame.geo_pose(&free)).expect("JSON");
        assert!(told["accuracy"]["horizontal"].is_null() && told["accuracy"]["vertical"].is_null(), "{told}");
    }

    #[test]
    fn what_is_no_frame_is_refused() {
        for text in [
            "",
            "1,2,3",
            "91,0,0,1,0,0,0",
            "0,181,0,1,0,0,0",
            "0,0,0,2,0,0,0",
            "0,0,x,1,0,0,0",
            "0,0,NaN,1,0,0,0",
            "0,0,0,1,0,0,0,0",
            "0,0,0,1,0,0,0,-1",
            "0,0,0,1,0,0,0,1,1",
            "0,0,0,0,0,0,0",
        ] {
            let error = text.parse::<GeoFrame>().expect_err("refused").to_string();
            assert!(error.contains("LAT,LON,HEIGHT"), "{text}: {error}");
        }
    }
}
