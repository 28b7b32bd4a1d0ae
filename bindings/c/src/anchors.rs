//! Content anchors: `GET /v1/maps/{map}/anchors`.

use std::ffi::{CString, c_char};

use veiloc_protocol::ContentAnchors;

use crate::alignment::VeilocAlignment;
use crate::pointers;
use crate::pose::{VeilocPose, axes};
use crate::status::{Failure, VeilocStatus, guarded};

/// The content anchors of a map, and where they are in the AR world.
pub struct VeilocAnchors {
    anchors: ContentAnchors,
    placed: Vec<Placed>,
}

struct Placed {
    name: CString,
    content: CString,
    world_from_anchor: VeilocPose,
    distance: f64,
}

/// A content anchor in the AR world. Its texts are valid until the anchors are placed again or freed.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct VeilocPlacedAnchor {
    /// Its name.
    pub name: *const c_char,
    /// Its content, JSON in UTF-8.
    pub content: *const c_char,
    /// Its pose, in the axes and units of the framework.
    pub world_from_anchor: VeilocPose,
    /// Its distance from the camera, metres.
    pub distance: f64,
}

/// Reads content anchors: the body of status 200. `VEILOC_STATUS_ANSWER` for anything else.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_anchors_new(
    bytes: *const u8,
    length: usize,
    out: *mut *mut VeilocAnchors,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate; the same for the others.
        let bytes = unsafe { pointers::slice(bytes, length, "bytes") }?;
        let anchors = ContentAnchors::decode(bytes).map_err(|e| Failure::new(VeilocStatus::Answer, e))?;
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocAnchors { anchors, placed: Vec::new() }) }
    })
}

/// Places the anchors in the AR world, the nearest to the camera first: again after each answer. `count` gets how many there are,
/// for `veiloc_anchors_get`; none before the first trusted answer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_anchors_place(
    anchors: *mut VeilocAnchors,
    alignment: *const VeilocAlignment,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
    count: *mut usize,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let VeilocAnchors { anchors, placed } = unsafe { pointers::mutable(anchors, "anchors") }?;
        // SAFETY: as above.
        let alignment = &unsafe { pointers::reference(alignment, "alignment") }?.alignment;
        // SAFETY: as above.
        let camera = unsafe { pointers::reference(camera_in_world, "camera_in_world") }?;
        let axes = axes(pose_axes)?;
        let found = alignment.place_anchors(axes, anchors, &camera.cam_from_ar(axes)?);
        // SAFETY: as above.
        unsafe { pointers::give(count, found.len(), "count") }?;
        // Neither names nor JSON have a zero byte.
        let text = |text: String| CString::new(text).unwrap_or_default();
        let of = |found: &veiloc_ar::PlacedAnchor<'_>| Placed {
            name: text(found.anchor.name.clone()),
            content: text(found.anchor.content.to_string()),
            world_from_anchor: found.world_from_anchor.into(),
            distance: found.distance,
        };
        *placed = found.iter().map(of).collect();
        Ok(())
    })
}

/// One of the placed anchors; 0 is the nearest.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_anchors_get(
    anchors: *const VeilocAnchors,
    index: usize,
    out: *mut VeilocPlacedAnchor,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let placed = &unsafe { pointers::reference(anchors, "anchors") }?.placed;
        let wrong = || Failure::new(VeilocStatus::Argument, format!("{} anchors are placed", placed.len()));
        let found = placed.get(index).ok_or_else(wrong)?;
        let (name, content) = (found.name.as_ptr(), found.content.as_ptr());
        let (world_from_anchor, distance) = (found.world_from_anchor, found.distance);
        let placed = VeilocPlacedAnchor { name, content, world_from_anchor, distance };
        // SAFETY: as above.
        unsafe { pointers::give(out, placed, "out") }
    })
}

/// Frees anchors.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_anchors_free(anchors: *mut VeilocAnchors) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(anchors) }
}

#[cfg(test)]
mod tests {
    /// Content anchors cross the border: their order, poses and texts, and what is refused.
    #[test]
    fn content_anchors_are_placed() {
        use super::*;
        use crate::alignment::{
            VeilocUpdate, veiloc_alignment_add, veiloc_alignment_free, veiloc_alignment_new,
        };
        use crate::answer::{veiloc_answer_free, veiloc_answer_new};
        use std::ffi::CStr;
        use std::ptr::{null, null_mut};

        let answer = std::fs::read(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../crates/core/protocol/tests/data/without-fit.answer"
        ));
        let mut answer = veiloc_protocol::Answer::decode(&answer.expect("a known answer")).expect("valid");
        answer.doubts.clear();
        let pose = answer.pose.as_mut().expect("a pose");
        pose.covariance = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 1e-6 } else { 0.0 }));
        let [x, y, z] = pose.center();
        let answer = answer.encode();
        let json = format!(
            r#"{{"version":1,"anchors":[{},{}]}}"#,
            format_args!(
                r#"{{"name":"far","map_from_anchor":{{"q":[1,0,0,0],"t":[{},{y},{z}]}},"content":"\u0000é"}}"#,
                x + 2.0
            ),
            format_args!(r#"{{"name":"here","map_from_anchor":{{"q":[1,0,0,0],"t":[{x},{y},{z}]}}}}"#),
        );
        let camera = VeilocPose { position: [5.0, 6.0, 7.0], rotation: [0.0, 0.0, 0.0, 1.0] };
        let (mut anchors, mut alignment, mut count) = (null_mut(), null_mut(), 7);
        let mut found = VeilocPlacedAnchor {
            name: null(),
            content: null(),
            world_from_anchor: VeilocPose::default(),
            distance: f64::NAN,
        };
        // SAFETY: each pointer is null or points to what its type says, and each handle is freed once.
        unsafe {
            assert_eq!(veiloc_anchors_new(json.as_ptr(), 20, &raw mut anchors), VeilocStatus::Answer);
            assert_eq!(veiloc_anchors_new(json.as_ptr(), json.len(), &raw mut anchors), VeilocStatus::Ok);
            assert_eq!(veiloc_alignment_new(1.0, &raw mut alignment), VeilocStatus::Ok);
            let mut place =
                |pose: *const VeilocPose| veiloc_anchors_place(anchors, alignment, 0, pose, &raw mut count);
            assert_eq!((place(&raw const camera), place(null())), (VeilocStatus::Ok, VeilocStatus::Argument));
            assert_eq!(count, 0, "no answer yet");
            let (mut read, mut update) = (null_mut(), VeilocUpdate::NoPose);
            assert_eq!(veiloc_answer_new(answer.as_ptr(), answer.len(), &raw mut read), VeilocStatus::Ok);
            veiloc_alignment_add(alignment, read, 0, &raw const camera, &raw mut update);
            assert_eq!(update, VeilocUpdate::Used);
            assert_eq!(
                veiloc_anchors_place(anchors, alignment, 0, &raw const camera, &raw mut count),
                VeilocStatus::Ok
            );
            assert_eq!(count, 2);
            for (i, name, content, distance) in
                [(0, c"here", c"null", 0.0), (1, c"far", c"\"\\u0000é\"", 2.0)]
            {
                assert_eq!(veiloc_anchors_get(anchors, i, &raw mut found), VeilocStatus::Ok);
                assert_eq!((CStr::from_ptr(found.name), CStr::from_ptr(found.content)), (name, content));
                let off = (0..3)
                    .map(|k| (found.world_from_anchor.position[k] - camera.position[k]).powi(2))
                    .sum::<f64>();
                assert!(
                    (found.distance - distance).abs() < 1e-9 && (off.sqrt() - distance).abs() < 1e-9,
                    "{found:?}"
                );
            }
            assert_eq!(veiloc_anchors_get(anchors, 2, &raw mut found), VeilocStatus::Argument);
            veiloc_answer_free(read);
            veiloc_alignment_free(alignment);
            veiloc_anchors_free(anchors);
            veiloc_anchors_free(null_mut());
        }
    }
}
