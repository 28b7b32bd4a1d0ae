//! Sealed queries with random codes, for the tests of this crate and for the known-answer files.
#![allow(dead_code)] // each test binary uses its own part

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use veiloc_descriptor::{
    DescriptorKind, Descriptors, Encoding, GlobalDescriptor, GlobalModel, NamedGlobal, Vocabulary,
};
use veiloc_geometry::Anchor;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_protocol::{
    AnchoredRow, AngleBits, Answer, AnswerDoubt, AnswerFit, AnswerPose, AnswerTimes, Candidate,
    CanonicalCamera, CoarseGravity, DoubtKind, FocalKnowledge, GravityUse, Hints, LayoutTurn, LineRow,
    MapCoordinates, MatchWeight, Pack, PositionRow, Profile, QueryParts, RowMatches, Rows, Scheme,
    SealedQuery, SentContent,
};

/// Numbers directly from the generator, so that the known answers do not depend on how a library draws ranges.
pub(crate) struct Draw(ChaCha8Rng);

impl Draw {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// From 0 to `n - 1`.
    pub(crate) fn below(&mut self, n: u32) -> u32 {
        ((u64::from(self.0.next_u32()) * u64::from(n)) >> 32) as u32
    }

    /// A position from the centre of an image of this size, quarter pixels.
    fn position(&mut self, [width, height]: [u32; 2]) -> [f64; 2] {
        [width, height].map(|size| f64::from(self.below(4 * size + 1)) / 4.0 - f64::from(size) / 2.0)
    }
}

pub(crate) fn vocabulary(draw: &mut Draw) -> Vocabulary {
    let bytes: Vec<u8> = (0..4 * 128).map(|_| draw.below(90) as u8).collect();
    Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).and_then(Vocabulary::new).expect("four whole words")
}

/// RootSIFT and a vocabulary of four words.
pub(crate) fn profile() -> Profile {
    Profile::vlad(vocabulary(&mut Draw::new(7)))
}

/// Signed descriptors of 48 numbers, and a global descriptor of 40 numbers that is computed from the image.
pub(crate) fn own_profile() -> Profile {
    let kind = DescriptorKind::new("own-kind", 48, Encoding::Signed, 300).expect("a kind");
    let global = NamedGlobal::new("own-global", 40).expect("a model");
    Profile::new(kind, GlobalModel::Named(global)).expect("no vocabulary to disagree with")
}

/// Sealed with [`profile`].
pub(crate) fn query(scheme: Scheme, bits: AngleBits, count: usize, seed: u64) -> SealedQuery {
    query_with(&profile(), scheme, bits, count, seed)
}

/// Compact descriptors, two numbers a byte, and a vocabulary of four words.
pub(crate) fn compact_profile() -> Profile {
    let kind = DescriptorKind::COMPACT;
    let mut draw = Draw::new(8);
    let words = (0..4 * kind.dim()).map(|_| draw.below(256) as u8).collect();
    Profile::vlad(Descriptors::new(kind, words).and_then(Vocabulary::new).expect("four whole words"))
}

/// Every profile that tests seal with.
pub(crate) fn profiles() -> [Profile; 3] {
    [profile(), own_profile(), compact_profile()]
}

pub(crate) fn query_with(
    profile: &Profile,
    scheme: Scheme,
    bits: AngleBits,
    count: usize,
    seed: u64,
) -> SealedQuery {
    query_with_hints(Hints::default(), profile, scheme, bits, count, seed)
}

/// A later frame of a session: the layout is rotated relative to its camera.
pub(crate) fn query_turned(turn: LayoutTurn, profile: &Profile, scheme: Scheme, seed: u64) -> SealedQuery {
    make_query((Hints::default(), turn), profile, scheme, AngleBits::default(), 256, seed)
}

pub(crate) fn query_with_hints(
    hints: Hints,
    profile: &Profile,
    scheme: Scheme,
    bits: AngleBits,
    count: usize,
    seed: u64,
) -> SealedQuery {
    make_query((hints, LayoutTurn::default()), profile, scheme, bits, count, seed)
}

/// A pack of three images and 20 points.
pub(crate) fn pack() -> Pack {
    let profile = compact_profile();
    let kind = profile.descriptor_kind();
    let mut draw = Draw::new(11);
    let mut image = |points: Vec<u32>| {
        let bytes = (0..points.len() * kind.dim()).map(|_| draw.below(256) as u8).collect();
        (points, Descriptors::new(kind, bytes).expect("whole rows"))
    };
    let images = [image((0..12).collect()), image((8..20).collect()), image(vec![0, 5, 5, 19])];
    Pack::new(profile, 20, images).expect("parts fit")
}

/// A query of 256 rows with a candidate each.
pub(crate) fn match_query(pack: &Pack) -> SealedQuery {
    let with_rows =
        query_with(pack.profile(), "dcl".parse().expect("a scheme"), AngleBits::default(), 256, 1);
    let mut draw = Draw::new(12);
    let rows = (0..256).map(|_| {
        let point = draw.below(pack.point_count());
        Candidate { point, weight: MatchWeight::of_probability(f64::from(draw.below(100)) / 100.0) }
    });
    let matches = RowMatches::new(pack.point_count(), rows.collect()).expect("of the pack");
    let bits = with_rows.angle_bits();
    let mut angles = Draw::new(13);
    let lines = (0..256).map(|_| {
        let anchor = Anchor::new(angles.below(2) as usize).expect("one of two");
        AnchoredRow::new(bits, anchor, bits.angle_on_circle(angles.below(bits.levels_of_circle())))
    });
    let parts = QueryParts {
        camera: with_rows.canonical_camera(),
        scheme: with_rows.scheme(),
        angle_bits: bits,
        rows: Rows::Dcl(lines.collect()),
        content: SentContent::Matched { pack: pack.id(), matches },
        hints: Hints::default(),
        turn: LayoutTurn::default(),
    };
    SealedQuery::new(pack.profile(), parts).expect("parts fit")
}

fn make_query(
    (hints, turn): (Hints, LayoutTurn),
    profile: &Profile,
    scheme: Scheme,
    bits: AngleBits,
    count: usize,
    seed: u64,
) -> SealedQuery {
    let mut draw = Draw::new(seed);
    let camera = CanonicalCamera::from_codes(36, 20, 15).expect("512 px, 640 × 480");
    let size = [camera.width(), camera.height()];
    let position = |draw: &mut Draw| {
        let [u, v] = draw.position(size);
        PositionRow::new(u, v).expect("inside")
    };
    let rows = match scheme {
        Scheme::Points => Rows::Points((0..count).map(|_| position(&mut draw)).collect()),
        Scheme::CoordinatePermutation => {
            Rows::CoordinatePermutation((0..count).map(|_| position(&mut draw)).collect())
        }
        Scheme::RandomLines => {
            let line = |draw: &mut Draw| {
                let angle = draw.below(bits.levels()) as u16;
                let [u, v] = draw.position(size);
                LineRow::through(bits, angle, u, v).expect("inside")
            };
            Rows::RandomLines((0..count).map(|_| line(&mut draw)).collect())
        }
        Scheme::Dcl(layout) => {
            let row = |draw: &mut Draw| {
                let anchor = Anchor::new(draw.below(layout.anchors() as u32) as usize).expect("one of few");
                let angle = bits.angle_on_circle(draw.below(bits.levels_of_circle()));
                AnchoredRow::new(bits, anchor, angle)
            };
            Rows::Dcl((0..count).map(|_| row(&mut draw)).collect())
        }
    };
    let kind = profile.descriptor_kind();
    let bytes = (0..count * kind.dim()).map(|_| draw.below(120) as u8).collect();
    let descriptors = Descriptors::new(kind, bytes).expect("whole rows");
    let image_global = profile.vocabulary().is_none().then(|| {
        let codes = (0..profile.global_model().global_len()).map(|_| draw.below(100) as i8 - 50);
        GlobalDescriptor::new(codes.collect())
    });
    let content = SentContent::Described { descriptors, image_global };
    let parts = QueryParts { camera, scheme, angle_bits: bits, rows, content, hints, turn };
    SealedQuery::new(profile, parts).expect("parts fit")
}

/// The known-answer files without their extensions, and their content.
pub(crate) fn known_answers() -> Vec<(String, SealedQuery)> {
    let schemes = ["points", "random-lines", "coordinate-permutation", "dcl", "dcl:angle=30,s=2"];
    let paper: Scheme = "dcl:paper".parse().expect("a scheme");
    let of = |name: &str| {
        let bits = AngleBits::new(if name == "dcl:angle=30,s=2" { 10 } else { 12 }).expect("allowed");
        let scheme: Scheme = if name == "dcl" { paper } else { name.parse().expect("a scheme") };
        (name.replace([':', '=', ','], "-"), query(scheme, bits, 256, 1))
    };
    let mut all: Vec<_> = schemes.into_iter().map(of).collect();
    let dcl =
        |profile: &Profile, hints| query_with_hints(hints, profile, paper, AngleBits::default(), 256, 1);
    all.push(("own-kind".to_owned(), dcl(&own_profile(), Hints::default())));
    let gravity = |down, sd| Some(CoarseGravity::new(down, sd).expect("a direction"));
    for (name, focal, gravity) in [
        ("exif-gravity", FocalKnowledge::Exif, gravity([0.3, 9.5, -2.0], 1.0)),
        ("unknown-gravity", FocalKnowledge::Unknown, gravity([-0.9, 0.1, -0.4], 5.0)),
    ] {
        all.push((name.to_owned(), dcl(&profile(), Hints { focal, gravity })));
    }
    all.push(("matches".to_owned(), match_query(&pack())));
    let turn =
        LayoutTurn::new(&Rotation3::from_scaled_axis(Vector3::new(0.125, -0.5, 0.0625))).expect("finite");
    for (name, scheme, turn) in [
        ("stripes", "dcl:axis=67,sectors=20,anchors=-0.12/-0.49+1.5/0", LayoutTurn::default()),
        (
            "board",
            "dcl:axis=90,sectors=21,shift=0.5,across=0/12/0.25,anchors=@90+@0+0/-20",
            LayoutTurn::default(),
        ),
        ("session", "dcl:axis=115,sectors=22,anchors=0.23/-0.33+-0.88/-0.47", turn),
        ("session-halves", "dcl:paper", turn),
    ] {
        let scheme = scheme.parse().expect("a layout");
        all.push((name.to_owned(), query_turned(turn, &profile(), scheme, 1)));
    }
    all
}

/// The profiles of these queries.
pub(crate) fn known_profiles() -> [(&'static str, Profile); 2] {
    [("sift", profile()), ("own-kind", own_profile())]
}

/// An answer with numbers that are exact in binary, so that nothing depends on rounding.
pub(crate) fn answer(seed: u64, doubts: usize) -> Answer {
    let mut draw = Draw::new(seed);
    let mut eighth = || f64::from(draw.below(1 << 12)) / 8.0 - 256.0;
    Answer {
        pose: Some(AnswerPose {
            rotation: [0.5, -0.5, 0.5, 0.5],
            translation: std::array::from_fn(|_| eighth()),
            covariance: std::array::from_fn(|i| {
                std::array::from_fn(|j| if i == 5 && j == 5 { f64::INFINITY } else { eighth() })
            }),
        }),
        doubts: DoubtKind::ALL
            .into_iter()
            .cycle()
            .take(doubts)
            .map(|kind| AnswerDoubt { kind, text: format!("because of {}", kind.name()) })
            .collect(),
        log_evidence: 812.5,
        margin: f64::INFINITY,
        fit: None,
        gravity: GravityUse::UnknownInMap,
        map: MapCoordinates::default(),
        inliers: 311,
        matches: 912,
        hypotheses: 64,
        times: AnswerTimes { queue_ms: 0.25, retrieve_ms: 0.5, match_ms: 12.0, pose_ms: 3.75 },
    }
}

/// The same answer with all that a service may leave out: its fit, the unit of the map and the direction of gravity.
pub(crate) fn answer_with_fit(seed: u64, doubts: usize) -> Answer {
    Answer {
        fit: Some(AnswerFit { noise_px: 0.75, focal_scale: 1.03125, principal_shift_px: [12.5, -0.75] }),
        gravity: GravityUse::Used,
        map: MapCoordinates { metres_per_unit: Some(1.0), down: Some([0.0, -1.0, 0.0]) },
        ..answer(seed, doubts)
    }
}

/// The known answers without their file extensions: of a service that does not report the fit, of one that does, and
/// one whose pose is withheld.
pub(crate) fn known_replies() -> [(&'static str, Answer); 3] {
    let doubtful = answer_with_fit(1, 2);
    [("without-fit", answer(1, 2)), ("doubtful", doubtful.clone()), ("withheld", doubtful.trusted_only())]
}
