/// veiloc for C++11 and newer: owners of the handles of veiloc.h, and exceptions in place of statuses.
///
/// Nothing here computes: each method is a function of veiloc.h.
#ifndef VEILOC_HPP
#define VEILOC_HPP

#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "veiloc.h"

namespace veiloc {

/// An error: what to do about it is its status.
class Error : public std::runtime_error {
 public:
  explicit Error(VeilocStatus status) : std::runtime_error(veiloc_last_error()), status(status) {}
  const VeilocStatus status;
};

inline void check(VeilocStatus status) {
  if (status != VEILOC_STATUS_OK) throw Error(status);
}

/// The deleters of all handles.
struct Free {
  void operator()(VeilocProfile *handle) const { veiloc_profile_free(handle); }
  void operator()(VeilocPack *handle) const { veiloc_pack_free(handle); }
  void operator()(VeilocSealer *handle) const { veiloc_sealer_free(handle); }
  void operator()(VeilocExtracted *handle) const { veiloc_extracted_free(handle); }
  void operator()(VeilocSession *handle) const { veiloc_session_free(handle); }
  void operator()(VeilocQuery *handle) const { veiloc_query_free(handle); }
  void operator()(VeilocBurst *handle) const { veiloc_burst_free(handle); }
  void operator()(VeilocSealedBurst *handle) const { veiloc_sealed_burst_free(handle); }
  void operator()(VeilocAnswer *handle) const { veiloc_answer_free(handle); }
  void operator()(VeilocAlignment *handle) const { veiloc_alignment_free(handle); }
  void operator()(VeilocAnchors *handle) const { veiloc_anchors_free(handle); }
  void operator()(VeilocCancellation *handle) const { veiloc_cancellation_free(handle); }
};

using Profile = std::unique_ptr<VeilocProfile, Free>;
/// For `VeilocOptions`: `options.pack = pack.get()`.
using Pack = std::unique_ptr<VeilocPack, Free>;
/// Several threads may use it at once.
using Sealer = std::unique_ptr<VeilocSealer, Free>;
using Extracted = std::unique_ptr<VeilocExtracted, Free>;
using Session = std::unique_ptr<VeilocSession, Free>;
using Query = std::unique_ptr<VeilocQuery, Free>;
/// `veiloc_burst_frames` and `veiloc_burst_clear` from any thread.
using Burst = std::unique_ptr<VeilocBurst, Free>;
/// `veiloc_sealed_burst_info` has its numbers.
using SealedBurst = std::unique_ptr<VeilocSealedBurst, Free>;
using Answer = std::unique_ptr<VeilocAnswer, Free>;
using Alignment = std::unique_ptr<VeilocAlignment, Free>;
using Anchors = std::unique_ptr<VeilocAnchors, Free>;
/// `veiloc_cancel` from any thread.
using Cancellation = std::unique_ptr<VeilocCancellation, Free>;
using Bytes = std::vector<uint8_t>;

inline Bytes taken(VeilocBytes bytes) {
  Bytes copy(bytes.data, bytes.data + bytes.length);
  veiloc_bytes_free(bytes);
  return copy;
}

inline Profile profile(const Bytes &bytes) {
  VeilocProfile *handle = nullptr;
  check(veiloc_profile_new(bytes.data(), bytes.size(), &handle));
  return Profile(handle);
}

inline Pack pack(const Bytes &bytes) {
  VeilocPack *handle = nullptr;
  check(veiloc_pack_new(bytes.data(), bytes.size(), &handle));
  return Pack(handle);
}

/// The profile that a pack contains.
inline Profile profile(const Pack &pack) {
  VeilocProfile *handle = nullptr;
  check(veiloc_pack_profile(pack.get(), &handle));
  return Profile(handle);
}

inline Session session(const char *anchors = nullptr) {
  VeilocSession *handle = nullptr;
  check(veiloc_session_new(anchors, &handle));
  return Session(handle);
}

inline Session session_from_bytes(const Bytes &bytes) {
  VeilocSession *handle = nullptr;
  check(veiloc_session_from_bytes(bytes.data(), bytes.size(), &handle));
  return Session(handle);
}

inline Bytes to_bytes(const Session &session) {
  VeilocBytes bytes{};
  check(veiloc_session_to_bytes(session.get(), &bytes));
  return taken(bytes);
}

/// `options` may be null.
inline Sealer sealer(const Profile &profile, const VeilocOptions *options = nullptr) {
  VeilocSealer *handle = nullptr;
  check(veiloc_sealer_new(profile.get(), options, &handle));
  return Sealer(handle);
}

/// `camera`, `camera_in_world` and `cancellation` may be null.
inline Extracted extract(const Sealer &sealer, const VeilocFrame &frame, const VeilocCamera *camera,
                         VeilocAxes axes = VEILOC_AXES_OPEN_GL, const VeilocPose *camera_in_world = nullptr,
                         const VeilocCancellation *cancellation = nullptr) {
  VeilocExtracted *handle = nullptr;
  check(veiloc_sealer_extract(sealer.get(), &frame, camera, axes, camera_in_world, cancellation, &handle));
  return Extracted(handle);
}

/// `session` may be null. The features are used up.
inline Query seal(const Sealer &sealer, VeilocSession *session, Extracted extracted) {
  VeilocQuery *handle = nullptr;
  check(veiloc_sealer_seal(sealer.get(), session, extracted.get(), &handle));
  return Query(handle);
}

/// `rows`: 0 for all.
inline Bytes bytes(const Query &query, uint32_t rows = 0) {
  VeilocBytes made{};
  check(veiloc_query_bytes(query.get(), rows, &made));
  return taken(made);
}

/// `options` may be null.
inline Burst burst(const VeilocBurstOptions *options = nullptr) {
  VeilocBurst *handle = nullptr;
  check(veiloc_burst_new(options, &handle));
  return Burst(handle);
}

/// Takes the unit of the map from an answer.
inline void learn_unit(const Burst &burst, const Answer &answer) {
  check(veiloc_burst_learn_unit(burst.get(), answer.get()));
}

/// `camera` may be null. `timestamp`: seconds.
inline void offer(const Burst &burst, const VeilocFrame &frame, const VeilocCamera *camera, VeilocAxes axes,
                  const VeilocPose &camera_in_world, double timestamp) {
  check(veiloc_burst_offer(burst.get(), &frame, camera, axes, &camera_in_world, timestamp));
}

/// `cancellation` may be null.
inline SealedBurst seal(const Burst &burst, const Sealer &sealer, const Session &session,
                        const VeilocCancellation *cancellation = nullptr) {
  VeilocSealedBurst *handle = nullptr;
  check(veiloc_burst_seal(burst.get(), sealer.get(), session.get(), cancellation, &handle));
  return SealedBurst(handle);
}

inline Bytes bytes(const SealedBurst &sealed) {
  VeilocBytes made{};
  check(veiloc_sealed_burst_bytes(sealed.get(), &made));
  return taken(made);
}

inline VeilocPose camera_in_world(const SealedBurst &sealed, VeilocAxes axes) {
  VeilocPose pose{};
  check(veiloc_sealed_burst_camera_in_world(sealed.get(), axes, &pose));
  return pose;
}

inline Answer answer(const uint8_t *bytes, size_t length) {
  VeilocAnswer *handle = nullptr;
  check(veiloc_answer_new(bytes, length, &handle));
  return Answer(handle);
}

/// The document that the service gives for `accept: application/json`, UTF-8.
inline Bytes json(const Answer &answer) {
  VeilocBytes made{};
  check(veiloc_answer_json(answer.get(), &made));
  return taken(made);
}

/// `metres_per_unit`: 0 for the unit that the answers state.
inline Alignment alignment(double metres_per_unit = 0.0) {
  VeilocAlignment *handle = nullptr;
  check(veiloc_alignment_new(metres_per_unit, &handle));
  return Alignment(handle);
}

inline Cancellation cancellation() {
  VeilocCancellation *handle = nullptr;
  check(veiloc_cancellation_new(&handle));
  return Cancellation(handle);
}

inline VeilocUpdate add(const Alignment &alignment, const Answer &answer, VeilocAxes axes, const VeilocPose &camera) {
  VeilocUpdate update{};
  check(veiloc_alignment_add(alignment.get(), answer.get(), axes, &camera, &update));
  return update;
}

inline VeilocPose world_from_anchor(const Alignment &alignment, VeilocAxes axes, const VeilocPose &map_from_anchor) {
  VeilocPose pose{};
  check(veiloc_alignment_world_from_anchor(alignment.get(), axes, &map_from_anchor, &pose));
  return pose;
}

inline Anchors anchors(const Bytes &bytes) {
  VeilocAnchors *handle = nullptr;
  check(veiloc_anchors_new(bytes.data(), bytes.size(), &handle));
  return Anchors(handle);
}

/// Content anchors in the AR world, the nearest first. Texts are valid until the next call.
inline std::vector<VeilocPlacedAnchor> place(const Anchors &anchors, const Alignment &alignment, VeilocAxes axes,
                                             const VeilocPose &camera) {
  size_t count = 0;
  check(veiloc_anchors_place(anchors.get(), alignment.get(), axes, &camera, &count));
  std::vector<VeilocPlacedAnchor> placed(count);
  for (size_t i = 0; i < count; i++) check(veiloc_anchors_get(anchors.get(), i, &placed[i]));
  return placed;
}

}  // namespace veiloc

#endif
