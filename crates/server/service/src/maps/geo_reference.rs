//! Where maps are on earth, and answers as GeoPoses (OGC 21-056).

use std::str::FromStr;

use serde::Serialize;
use utoipa::ToSchema;
use veiloc_geometry::nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use veiloc_geometry::{Geodetic, rotation_to_z};
use veiloc_map::AlignmentAccuracy;
use veiloc_protocol::AnswerPose;

/// Where a map in metres is on earth.
#[derive(Debug, Clone, PartialEq)]
pub struct GeoReference {
    /// Name of the map.
    pub map: String,
    /// Where the origin of the map is.
    pub origin: Geodetic,
    /// Direction of the map's `x` axis, with the map rotated so that its up is `z`: degrees from east, counter-clockwise
    /// seen from above. 0 for a map that `veiloc map align --gps` aligned.
    pub x_from_east_deg: f64,
}

impl FromStr for GeoReference {
    type Err = String;

    /// `NAME=LATITUDE,LONGITUDE,HEIGHT` and, if `x` is not east, `,DEGREES`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let expected = || {
            "NAME=LATITUDE,LONGITUDE,HEIGHT[,DEGREES] is expected: degrees, metres above the ellipsoid, and the direction \
             of the map's x axis in degrees from east, for example lobby=47.3769,8.5417,455"
                .to_owned()
        };
        let (map, numbers) = text.split_once('=').filter(|(map, _)| !map.is_empty()).ok_or_else(expected)?;
        let numbers: Result<Vec<f64>, _> = numbers.split(',').map(|number| number.trim().parse()).collect();
        let numbers = numbers.map_err(|_| expected())?;
        let ([latitude, longitude, altitude], rest) = numbers.split_first_chunk().ok_or_else(expected)?;
        let &[x_from_east_deg] = (if rest.is_empty() { &[0.0] } else { rest }) else {
            return Err(expected());
        };
        let origin = Geodetic { latitude: *latitude, longitude: *longitude, altitude: *altitude };
        let is_on_earth = latitude.abs() <= 90.0 && longitude.abs() <= 180.0 && altitude.abs() <= 100_000.0;
        let is_valid = is_on_earth && x_from_east_deg.abs() <= 360.0;
        is_valid.then(|| Self { map: map.to_owned(), origin, x_from_east_deg }).ok_or_else(expected)
    }
}

impl GeoReference {
    /// A pose in the map as a GeoPose with its accuracy; `None` when the pose leaves a direction free. `down` is the direction of
    /// gravity in the map (−z if it is not known), and the accuracy includes that of the map's alignment, if it is known.
    pub(crate) fn geopose(
        &self,
        pose: &AnswerPose,
        down: Option<[f64; 3]>,
        alignment: Option<AlignmentAccuracy>,
    ) -> Option<(GeoPose, GeoPoseAccuracy)> {
        let up = -Vector3::from(down.unwrap_or([0.0, 0.0, -1.0]));
        let heading = Rotation3::from_axis_angle(&Vector3::z_axis(), self.x_from_east_deg.to_radians());
        let enu_from_map = heading * rotation_to_z(&up);
        let position = self.origin.at_east_north_up(&(enu_from_map * Vector3::from(pose.center())));
        // East, north and up at the camera are not exactly those at the origin.
        let here_from_origin = position.enu_from_ecef() * self.origin.enu_from_ecef().transpose();
        let [w, x, y, z] = pose.rotation;
        let cam_from_map = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let enu_from_body =
            here_from_origin * enu_from_map.matrix() * cam_from_map.matrix().transpose() * CAM_FROM_BODY;
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(enu_from_body));
        let center_covariance = pose.center_covariance();
        let mean_sd = |variances: [f64; 3]| variances.map(f64::sqrt).iter().sum::<f64>() / 3.0;
        let (place, turn) = alignment.map_or((0.0, 0.0), |alignment| alignment.at(pose.center()));
        let accuracy = GeoPoseAccuracy {
            position: mean_sd([0, 1, 2].map(|i| center_covariance[i][i])).hypot(place),
            orientation: mean_sd([0, 1, 2].map(|i| pose.covariance[i][i])).to_degrees().hypot(turn),
        };
        let (Geodetic { latitude, longitude, altitude }, q) = (position, rotation.coords);
        let geopose = GeoPose {
            position: GeoPosition { lat: latitude, lon: longitude, h: altitude },
            quaternion: GeoQuaternion { x: q.x, y: q.y, z: q.z, w: q.w },
        };
        let numbers =
            [latitude, longitude, altitude, q.x, q.y, q.z, q.w, accuracy.position, accuracy.orientation];
        numbers.iter().all(|number| number.is_finite()).then_some((geopose, accuracy))
    }
}

/// Axes of a GeoPose's body are `x` right, `y` forward and `z` up, those of a camera here `x` right, `y` down and `z`
/// forward: upright and towards north, the quaternion is 1.
const CAM_FROM_BODY: Matrix3<f64> = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0);

/// A position and an orientation on earth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub(crate) struct GeoPose {
    pub(crate) position: GeoPosition,
    pub(crate) quaternion: GeoQuaternion,
}

/// WGS 84: degrees, and metres above the ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub(crate) struct GeoPosition {
    pub(crate) lon: f64,
    pub(crate) lat: f64,
    pub(crate) h: f64,
}

/// From the body (`x` right, `y` forward, `z` up) to east, north and up at the position.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub(crate) struct GeoQuaternion {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) z: f64,
    pub(crate) w: f64,
}

/// Standard deviations: means over three axes, of the pose in the map and of the map on earth as far as its alignment says.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub(crate) struct GeoPoseAccuracy {
    /// Metres.
    pub(crate) position: f64,
    /// Degrees.
    pub(crate) orientation: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera 10 m along the map's `x` axis, 1.5 m above its origin, that looks along `x`, upright.
    fn along_x() -> AnswerPose {
        // Rows are the camera's axes in the map: right is -y, down is -z, forward is x.
        let rotation =
            Rotation3::from_matrix_unchecked(Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0));
        let q = UnitQuaternion::from_rotation_matrix(&rotation);
        let center = Vector3::new(10.0, 0.0, 1.5);
        let mut covariance = [[0.0; 6]; 6];
        for i in 0..3 {
            covariance[i][i] = 0.01_f64.powi(2);
            // 0.01 along x, 0.02 along y and 0.06 along z of the map.
            covariance[3 + i][3 + i] = [0.02_f64, 0.06, 0.01][i].powi(2);
        }
        AnswerPose { rotation: [q.w, q.i, q.j, q.k], translation: (-(rotation * center)).into(), covariance }
    }

    fn near(found: GeoQuaternion, expected: [f64; 4]) -> bool {
        let found = [found.x, found.y, found.z, found.w];
        let dot: f64 = found.iter().zip(&expected).map(|(a, b)| a * b).sum();
        dot.abs() > 1.0 - 1e-10
    }

    #[test]
    fn a_camera_that_looks_north_has_the_quaternion_one() {
        // The map's x axis is north.
        let place: GeoReference = "lobby=47.0,8.0,400,90".parse().expect("valid");
        let (geopose, accuracy) = place.geopose(&along_x(), None, None).expect("a pose");
        assert!(near(geopose.quaternion, [0.0, 0.0, 0.0, 1.0]), "{geopose:?}");
        let offset = place.origin.east_north_up(&Geodetic {
            latitude: geopose.position.lat,
            longitude: geopose.position.lon,
            altitude: geopose.position.h,
        });
        assert!((offset - Vector3::new(0.0, 10.0, 1.5)).norm() < 1e-6, "{offset}");
        assert!((accuracy.position - 0.03).abs() < 1e-12, "{accuracy:?}");
        assert!((accuracy.orientation - 0.01_f64.to_degrees()).abs() < 1e-12, "{accuracy:?}");
    }

    #[test]
    fn a_camera_that_looks_east_is_turned_clockwise() {
        let place: GeoReference = "lobby=47.0,8.0,400".parse().expect("valid");
        let (geopose, _) = place.geopose(&along_x(), None, None).expect("a pose");
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!(near(geopose.quaternion, [0.0, 0.0, -half, half]), "{geopose:?}");
        assert!(geopose.position.lon > 8.0001 && (geopose.position.lat - 47.0).abs() < 1e-9, "{geopose:?}");
    }

    /// The same camera in a map whose `y` is up, as of AR captures.
    #[test]
    fn a_map_is_turned_by_its_gravity() {
        let place: GeoReference = "lobby=47.0,8.0,400".parse().expect("valid");
        let (expected, _) = place.geopose(&along_x(), Some([0.0, 0.0, -1.0]), None).expect("a pose");
        let y_up_from_z_up = Rotation3::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
        let [w, x, y, z] = along_x().rotation;
        let in_z_up = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let q = UnitQuaternion::from_rotation_matrix(&(in_z_up * y_up_from_z_up.inverse()));
        let pose = AnswerPose { rotation: [q.w, q.i, q.j, q.k], ..along_x() };
        let (found, _) = place.geopose(&pose, Some([0.0, -1.0, 0.0]), None).expect("a pose");
        assert!((found.position.h - expected.position.h).abs() < 1e-6, "{found:?} {expected:?}");
        assert!((found.position.lon - expected.position.lon).abs() < 1e-11, "{found:?} {expected:?}");
        let GeoQuaternion { x, y, z, w } = expected.quaternion;
        assert!(near(found.quaternion, [x, y, z, w]), "{found:?} {expected:?}");
        let (wrong, _) = place.geopose(&pose, None, None).expect("a pose");
        assert!((wrong.position.h - expected.position.h).abs() > 1.0);
    }

    #[test]
    fn accuracy_includes_that_of_the_alignment() {
        let place: GeoReference = "lobby=47.0,8.0,400".parse().expect("valid");
        let alignment = AlignmentAccuracy {
            scale: 0.01,
            tilt_deg: 2.0,
            heading_deg: 1.0,
            position: 1.2,
            center: [10.0, 0.0, 1.5],
        };
        let (_, accuracy) = place.geopose(&along_x(), None, Some(alignment)).expect("a pose");
        assert!((accuracy.position - 0.03_f64.hypot(1.2 / 3.0_f64.sqrt())).abs() < 1e-9, "{accuracy:?}");
        assert!((accuracy.orientation - 0.01_f64.to_degrees().hypot((5.0_f64 / 3.0).sqrt())).abs() < 1e-9);
    }

    #[test]
    fn a_free_direction_has_no_geopose() {
        let place: GeoReference = "lobby=47.0,8.0,400".parse().expect("valid");
        let mut pose = along_x();
        pose.covariance[4][4] = f64::INFINITY;
        assert_eq!(place.geopose(&pose, None, None), None);
    }

    #[test]
    fn invalid_references_are_refused() {
        for text in [
            "47,8,400",
            "=47,8,400",
            "lobby=47,8",
            "lobby=47,8,400,0,0",
            "lobby=91,8,400",
            "lobby=47,181,400",
            "lobby=47,8,x",
            "lobby=NaN,8,400",
            "lobby=47,8,400,inf",
        ] {
            assert!(text.parse::<GeoReference>().is_err(), "{text}");
        }
        let place: GeoReference = "lobby=-47.5, 8,400,-12.5".parse().expect("valid");
        assert_eq!((place.origin.latitude, place.x_from_east_deg), (-47.5, -12.5));
    }
}
