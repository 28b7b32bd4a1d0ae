//! Positions on earth (WGS 84), and local frames of east, north and up.

use std::fmt;

use nalgebra::{Matrix3, Vector3};

/// Semi-major axis of the ellipsoid of WGS 84, metres.
const SEMI_MAJOR: f64 = 6_378_137.0;
/// Its flattening.
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Its squared eccentricity.
const ECCENTRICITY_2: f64 = FLATTENING * (2.0 - FLATTENING);

/// A position on earth, WGS 84.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geodetic {
    /// Degrees north.
    pub latitude: f64,
    /// Degrees east.
    pub longitude: f64,
    /// Metres above the ellipsoid, as far as known. (Phones often store metres above the sea instead.)
    pub altitude: f64,
}

impl fmt::Display for Geodetic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.7}, {:.7}, {:.2} m", self.latitude, self.longitude, self.altitude)
    }
}

impl Geodetic {
    /// Earth-centred, earth-fixed coordinates, metres.
    pub fn ecef(&self) -> Vector3<f64> {
        let (sin_lat, cos_lat) = self.latitude.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude.to_radians().sin_cos();
        let normal = normal(sin_lat);
        let across = (normal + self.altitude) * cos_lat;
        Vector3::new(
            across * cos_lon,
            across * sin_lon,
            (normal * (1.0 - ECCENTRICITY_2) + self.altitude) * sin_lat,
        )
    }

    /// From earth-centred, earth-fixed coordinates, metres; to 1e-12 degrees and 1e-6 metres near the surface.
    pub fn from_ecef(position: &Vector3<f64>) -> Self {
        let across = position.x.hypot(position.y);
        // A fixed point: the distance along the normal to the axis is known from the last latitude. Each step multiplies
        // the error by less than 1/100.
        let mut latitude = position.z.atan2(across * (1.0 - ECCENTRICITY_2));
        for _ in 0..8 {
            let sin = latitude.sin();
            latitude = (position.z + ECCENTRICITY_2 * normal(sin) * sin).atan2(across);
        }
        let (sin, cos) = latitude.sin_cos();
        // Projected onto the normal, which also holds at the poles.
        let altitude =
            across * cos + position.z * sin - SEMI_MAJOR * (1.0 - ECCENTRICITY_2 * sin * sin).sqrt();
        Self {
            latitude: latitude.to_degrees(),
            longitude: position.y.atan2(position.x).to_degrees(),
            altitude,
        }
    }

    /// Rotation from earth-centred, earth-fixed axes to east, north and up at this position.
    pub fn enu_from_ecef(&self) -> Matrix3<f64> {
        let (sin_lat, cos_lat) = self.latitude.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude.to_radians().sin_cos();
        Matrix3::new(
            -sin_lon,
            cos_lon,
            0.0,
            -sin_lat * cos_lon,
            -sin_lat * sin_lon,
            cos_lat,
            cos_lat * cos_lon,
            cos_lat * sin_lon,
            sin_lat,
        )
    }

    /// East, north and up of a position from this one, metres.
    pub fn east_north_up(&self, other: &Self) -> Vector3<f64> {
        self.enu_from_ecef() * (other.ecef() - self.ecef())
    }

    /// The position at this east, north and up from this one, metres: the inverse of [`Self::east_north_up`].
    pub fn at_east_north_up(&self, offset: &Vector3<f64>) -> Self {
        Self::from_ecef(&(self.ecef() + self.enu_from_ecef().transpose() * offset))
    }
}

/// Distance from the surface to the axis along the normal, metres.
fn normal(sin_lat: f64) -> f64 {
    SEMI_MAJOR / (1.0 - ECCENTRICITY_2 * sin_lat * sin_lat).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ellipsoid_is_that_of_wgs_84() {
        let at = |latitude, longitude, altitude| Geodetic { latitude, longitude, altitude }.ecef();
        assert!((at(0.0, 0.0, 0.0) - Vector3::new(6_378_137.0, 0.0, 0.0)).norm() < 1e-6);
        assert!((at(90.0, 0.0, 0.0) - Vector3::new(0.0, 0.0, 6_356_752.314_245)).norm() < 1e-5);
        assert!((at(0.0, 90.0, 10.0) - Vector3::new(0.0, 6_378_147.0, 0.0)).norm() < 1e-6);
    }

    #[test]
    fn local_frame_is_east_north_up() {
        let here = Geodetic { latitude: 47.0, longitude: 8.0, altitude: 400.0 };
        let to = |latitude: f64, longitude: f64, altitude: f64| {
            here.east_north_up(&Geodetic { latitude, longitude, altitude })
        };
        assert!((to(47.0, 8.0, 402.5) - Vector3::new(0.0, 0.0, 2.5)).norm() < 1e-6);
        // An arc second: 30.88 m north at this latitude (radius of the meridian 6 369 700 m), 21.13 m east.
        let north = to(47.0 + 1.0 / 3600.0, 8.0, 400.0);
        assert!((north - Vector3::new(0.0, 30.88, 0.0)).norm() < 0.02, "{north}");
        let east = to(47.0, 8.0 + 1.0 / 3600.0, 400.0);
        assert!((east - Vector3::new(21.13, 0.0, 0.0)).norm() < 0.02, "{east}");
    }

    #[test]
    fn positions_return_from_both_frames() {
        for (latitude, longitude, altitude) in [
            (0.0, 0.0, 0.0),
            (47.3, 8.5, 410.0),
            (-33.9, 151.2, -20.0),
            (89.9999, -120.0, 3000.0),
            (-90.0, 0.0, 5.0),
        ] {
            let place = Geodetic { latitude, longitude, altitude };
            let found = Geodetic::from_ecef(&place.ecef());
            assert!((found.latitude - latitude).abs() < 1e-11, "{place}: {found}");
            assert!((found.altitude - altitude).abs() < 1e-6, "{place}: {found}");
            let offset = Vector3::new(120.0, -45.0, 3.0);
            let back = place.east_north_up(&place.at_east_north_up(&offset));
            assert!((back - offset).norm() < 1e-6, "{place}: {back}");
        }
    }
}
