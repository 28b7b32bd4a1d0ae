//! Visual localization without revealing the image or its keypoint positions.
//!
//! One crate for device and server side; each is a cargo feature, so that an app for devices contains no server code,
//! and vice versa.
//! This is the crate whose interface is kept; the crates that it is made of are internal.
//!
//! | module | feature | what it does |
//! |---|---|---|
//! | [`device`] | `device` | image → features → [`SealedQuery`](device::SealedQuery) → the service's answer |
//! | [`server`] | `server` | posed images → map; sealed query and map → pose |
//! | `server::self_test` | `self-test` (off) | a map localizes its own images to calibrate its answers |
//! | `audit` | `audit` (off) | attacks the user's own images and reports what leaks |
//!
//! `examples/map_and_localize.rs`, `examples/session.rs` and `examples/attack_own_images.rs` run without any data:
//! `cargo run --release -p veiloc --example map_and_localize`.
//!
//! # Device and server side in one program
//! On a rendered scene; all later steps are the same for real images.
//! ```
//! use veiloc::device::{
//!     DeviceLimits, Image, KnownPlace, PackUse, SealOptions, SealedQuery, Sealer, device_rng,
//! };
//! use veiloc::geometry::{CameraFromWorld, Intrinsics};
//! use veiloc::server::{
//!     BuildOptions, FinishOptions, GravityDirection, Input, LocalizeOptions, MapFile, PosedImage, PosedImages, build,
//!     finish, localize, write_map,
//! };
//! # use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom};
//!
//! let folder = tempfile::tempdir()?;
//! let camera: Intrinsics = "SIMPLE_RADIAL,400,300,330,200,150,-0.02".parse()?;
//! # let place = RenderedRoom::generate(11);
//! # let path = place.camera_path(&PathOptions::with_counts(30, 9));
//! let mapped: Vec<(String, CameraFromWorld)> = /* names and poses of the map's images */
//! #     path.mapping[..10].iter().enumerate().map(|(i, pose)| (format!("map-{i}.png"), *pose)).collect();
//! let (query, truth) = ("query.png", path.queries[0]);
//! # let queries = [(query, &truth), ("other.png", &path.queries[1])];
//! # for (seed, (name, pose)) in (1..).zip(mapped.iter().map(|(n, p)| (n.as_str(), p)).chain(queries)) {
//! #     place.render(pose, &camera, &RenderOptions::with_seed(seed)).rgb().save(folder.path().join(name))?;
//! # }
//!
//! // The operator: posed images to a map file.
//! let posed = |(name, cam_from_world)| PosedImage { name, camera, cam_from_world, seen: Vec::new() };
//! let posed = PosedImages::new(mapped.into_iter().map(posed).collect(), Vec::new())?;
//! let (mut model, mut report) = build(&Input::new(&posed, folder.path()), &BuildOptions::default(), &())?;
//! // As far as that is known: for devices that feel gravity.
//! model.down = Some(GravityDirection::new([0.0, 0.0, -1.0])?);
//! finish(&mut model, &mut report.warnings, &FinishOptions::default(), &())?;
//! assert!(report.warnings.is_empty());
//! write_map(&model, &folder.path().join("place.vmap"))?;
//!
//! // The device: it needs the map's profile, which holds no map data.
//! let sealer = Sealer::new(&model.profile, SealOptions::default())?;
//! let extracted = sealer.extract(Image::open(&folder.path().join(query))?, camera)?;
//! let bytes = sealer.seal(extracted, &mut device_rng()?)?.encode(); // all that leaves the device
//!
//! // The server.
//! let map = MapFile::open(&folder.path().join("place.vmap"))?;
//! let found = localize(&SealedQuery::decode(&bytes)?, &map, &LocalizeOptions::default())?;
//! assert!(found.confidence.is_trusted());
//! assert!(found.cam_from_world.translation_error(&truth) < 0.05);
//!
//! // A device that has the map's pack sends the points that it matches, and no descriptor.
//! let (pack, _) = map.pack()?;
//! let options = SealOptions::default().with_place(KnownPlace::new(pack)?, PackUse::Matches);
//! let sealer = Sealer::new(map.profile(), options)?;
//! let extracted = sealer.extract(Image::open(&folder.path().join("other.png"))?, camera)?;
//! let query = sealer.seal(extracted, &mut device_rng()?)?;
//! assert!(query.descriptors().is_none() && query.encode().len() < bytes.len());
//! assert!(localize(&query, &map, &LocalizeOptions::default())?.confidence.is_trusted());
//! # let _: DeviceLimits;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! How to add your own features, attacks, data sets and more: `docs/guide/extending.md`.
#![forbid(unsafe_code)]

#[cfg(feature = "audit")]
pub mod audit;
#[cfg(feature = "device")]
pub mod device;
#[cfg(feature = "server")]
pub mod server;

/// Frames, cameras, poses, lines: types that device and server side share.
pub use veiloc_geometry as geometry;
/// The sealed query, the profile and the answer: the messages between device and server.
pub use veiloc_protocol as protocol;
