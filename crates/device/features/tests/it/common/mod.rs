//! Set-up that several tests share.

pub mod exif;
