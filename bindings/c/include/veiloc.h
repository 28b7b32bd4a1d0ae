/*
 * veiloc: the device side of visual localization without revealing images or keypoint positions.
 *
 * Handles are made by *_new functions and freed by the *_free function of their type; null may be freed. One thread at a time
 * uses a handle. Bytes that a function returns are freed by veiloc_bytes_free; texts are not freed. Pointers that a function only
 * reads are not kept. A function that fails changes nothing; veiloc_last_error says why, on the same thread.
 *
 * Generated from bindings/c/src by `cargo xtask c-header`.
 */

#ifndef VEILOC_H
#define VEILOC_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// What the user should do.
typedef enum VeilocAdvice {
  // The frame is too dark.
  VEILOC_ADVICE_TOO_DARK = 0,
  // The camera turns so fast that frames are blurred.
  VEILOC_ADVICE_MOVE_SLOWER = 1,
  // The frame shows too little texture.
  VEILOC_ADVICE_SHOW_MORE_DETAIL = 2,
  // The frame shows texture on one side only.
  VEILOC_ADVICE_SHOW_BOTH_SIDES = 3,
  // Several frames were not found: this may be another place.
  VEILOC_ADVICE_NOT_IN_THIS_PLACE = 4,
  // The frame was not found.
  VEILOC_ADVICE_TURN_TO_MAPPED_PLACE = 5,
  // What the frame shows exists in several places of the map.
  VEILOC_ADVICE_SHOW_SURROUNDINGS = 6,
  // What the frame shows is too far away, or in too small a part of it.
  VEILOC_ADVICE_MOVE_CLOSER = 7,
  // The pose is trusted.
  VEILOC_ADVICE_READY = 8,
} VeilocAdvice;

// What an app does about an error.
typedef enum VeilocStatus {
  // No error.
  VEILOC_STATUS_OK = 0,
  // An argument is invalid: null, an unknown word or number, a pose that is no rotation.
  VEILOC_STATUS_ARGUMENT = 1,
  // The bytes are not a profile of this version: fetch it again, or update the app.
  VEILOC_STATUS_PROFILE = 2,
  // The frame or its camera cannot be used: sizes, strides, lengths.
  VEILOC_STATUS_IMAGE = 3,
  // Too little texture, or on one side only: take another frame.
  VEILOC_STATUS_TEXTURE = 4,
  // Too few rows on one side of the dividing line: the query must not be sent; take another frame.
  VEILOC_STATUS_UNBALANCED = 5,
  // The bytes are not a session: begin a new one.
  VEILOC_STATUS_SESSION = 6,
  // The session would have to be placed anew too often: walk on, and show another view.
  VEILOC_STATUS_TOO_MANY_STARTS = 7,
  // The camera turned away from the session's anchors: turn on or back.
  VEILOC_STATUS_TURNED_AWAY = 8,
  // The frame cannot be sealed as the profile and the options ask.
  VEILOC_STATUS_SEAL = 9,
  // The bytes are not an answer, or content anchors, of this version.
  VEILOC_STATUS_ANSWER = 10,
  // There is no trusted answer yet.
  VEILOC_STATUS_NOT_ALIGNED = 11,
  // An error of the library: please report it.
  VEILOC_STATUS_INTERNAL = 12,
  // The call was cancelled; nothing changed.
  VEILOC_STATUS_CANCELLED = 13,
  // The bytes are not a pack of this version, or it has descriptors with which packs are not used: fetch it again, or
  // update the app.
  VEILOC_STATUS_PACK = 14,
  // Hardly anything in the frame is of the place of the pack: point the camera at the place.
  VEILOC_STATUS_NOT_THIS_PLACE = 15,
} VeilocStatus;

// What an answer did.
typedef enum VeilocUpdate {
  // It is part of the transform.
  VEILOC_UPDATE_USED = 0,
  // It is trusted but contradicts the transform, which did not move.
  VEILOC_UPDATE_CONTRADICTS = 1,
  // It is doubtful and agrees. Nothing changed.
  VEILOC_UPDATE_DOUBTFUL_AGREES = 2,
  // It is doubtful and contradicts, or there is no transform. Nothing changed.
  VEILOC_UPDATE_DOUBTFUL = 3,
  // It has no pose, or one with a free direction. Nothing changed.
  VEILOC_UPDATE_NO_POSE = 4,
  // It does not state the unit of the map, and `veiloc_alignment_new` got none. Nothing changed.
  VEILOC_UPDATE_UNKNOWN_UNIT = 5,
} VeilocUpdate;

// How far the transform is known.
typedef enum VeilocAlignmentState {
  // No trusted answer came yet.
  VEILOC_ALIGNMENT_STATE_SEARCHING = 0,
  // One answer: content may be shown, and may move.
  VEILOC_ALIGNMENT_STATE_TENTATIVE = 1,
  // At least two answers agree.
  VEILOC_ALIGNMENT_STATE_ALIGNED = 2,
} VeilocAlignmentState;

// What distances between answers say, compared with the AR framework's.
typedef enum VeilocDistances {
  // Too few answers, or too near to each other.
  VEILOC_DISTANCES_UNKNOWN = 0,
  // They agree within 5 %.
  VEILOC_DISTANCES_AGREE = 1,
  // They differ: check the unit of the map and the focal length.
  VEILOC_DISTANCES_DIFFER = 2,
} VeilocDistances;

// Axes and units of a framework.
typedef enum VeilocAxes {
  // ARKit, ARCore, WebXR, OpenXR: y up, looks along -z, metres.
  VEILOC_AXES_OPEN_GL = 0,
  // Unity: left-handed, y up, looks along z, metres.
  VEILOC_AXES_UNITY = 1,
  // Unreal: left-handed, z up, looks along x, centimetres.
  VEILOC_AXES_UNREAL = 2,
  // Cameras as in COLMAP and OpenCV: y down, look along z; the world is that of OpenGl, or of the map. Metres.
  VEILOC_AXES_COLMAP = 3,
} VeilocAxes;

// Bytes of a pixel.
typedef enum VeilocPixelFormat {
  // One byte: gray, or the first plane of YUV 420 (the other planes are not needed).
  VEILOC_PIXEL_FORMAT_GRAY = 0,
  // Red, green, blue, ignored.
  VEILOC_PIXEL_FORMAT_RGBA = 1,
  // Blue, green, red, ignored.
  VEILOC_PIXEL_FORMAT_BGRA = 2,
} VeilocPixelFormat;

// How well the focal length is known.
typedef enum VeilocFocal {
  // Calibrated: what ARKit and ARCore give.
  VEILOC_FOCAL_CALIBRATED = 0,
  // From the EXIF data of an image.
  VEILOC_FOCAL_EXIF = 1,
  // A guess.
  VEILOC_FOCAL_UNKNOWN = 2,
} VeilocFocal;

// Which values of a mask hide a pixel.
typedef enum VeilocMaskKind {
  // All but 0: ARKit's `segmentationBuffer`, the categories of MediaPipe's multiclass segmenter.
  VEILOC_MASK_KIND_MARKED = 0,
  // 51 and more: a confidence, 255 for certain.
  VEILOC_MASK_KIND_CONFIDENCE = 1,
  // Person (10) and vehicle (9) of ARCore's scene semantics.
  VEILOC_MASK_KIND_ARCORE_SEMANTICS = 2,
  // Below 128: black hides, as in mask files of COLMAP.
  VEILOC_MASK_KIND_DARK_HIDES = 3,
} VeilocMaskKind;

// What is sent with a pack.
typedef enum VeilocPackUse {
  // The points that keypoints match in the pack, and no descriptor.
  VEILOC_PACK_USE_MATCHES = 0,
  // The descriptors that the pack explains.
  VEILOC_PACK_USE_EXPLAINED = 1,
} VeilocPackUse;

// Answers of one AR session, and the transform that most of them agree on.
typedef struct VeilocAlignment VeilocAlignment;

// The content anchors of a map, and where they are in the AR world.
typedef struct VeilocAnchors VeilocAnchors;

// An answer: where a frame was taken.
typedef struct VeilocAnswer VeilocAnswer;

// The sharpest frames of the last second. Unlike other handles, one thread may offer frames while another seals.
//
// It copies the gray bytes of the frames that it keeps: at most `frames` times width times height.
typedef struct VeilocBurst VeilocBurst;

// A request to stop. Unlike other handles, any thread may use it while another extracts with it.
typedef struct VeilocCancellation VeilocCancellation;

// The features of a frame, until they are sealed. They hold positions of keypoints, and are never sent.
typedef struct VeilocExtracted VeilocExtracted;

// What a place looks like, without where: with it a device sends only what the place knows. Several sealers may share it.
typedef struct VeilocPack VeilocPack;

// What a device needs to seal for a map.
typedef struct VeilocProfile VeilocProfile;

// A sealed query.
typedef struct VeilocQuery VeilocQuery;

// A burst that was sealed.
typedef struct VeilocSealedBurst VeilocSealedBurst;

// Seals frames for one map. Unlike other handles, several threads may use it at once.
typedef struct VeilocSealer VeilocSealer;

// Frames of one place, sealed so that their lines do not cross in the keypoints.
typedef struct VeilocSession VeilocSession;

// What is known about a sealed query.
typedef struct VeilocQueryInfo {
  // Rows of the query.
  uint32_t rows;
  // Keypoints that were found in the frame.
  uint32_t keypoints;
  // Mean gray of the frame, 0 to 1.
  double brightness;
  // How many of `steps` are used.
  uint32_t step_count;
  // Rows of each step of progressive localization that can determine a pose, ascending.
  uint32_t steps[8];
} VeilocQueryInfo;

// A pose as a framework states it: where an object is in the world, and how it is turned there.
typedef struct VeilocPose {
  // Position in the world.
  double position[3];
  // Quaternion x, y, z, w: from the object's axes to the world's.
  double rotation[4];
} VeilocPose;

// The numbers of an alignment.
typedef struct VeilocAlignmentInfo {
  // How far the transform is known.
  enum VeilocAlignmentState state;
  // Answers that it is the average of.
  uint32_t used;
  // Trusted answers that contradict it.
  uint32_t contradicting;
  // What distances between answers say.
  enum VeilocDistances distances;
  // Distances in the map divided by those of the AR framework; 0 while there are none.
  double distance_ratio;
} VeilocAlignmentInfo;

// Radii of 68 % confidence, as ARCore states them.
typedef struct VeilocAccuracy {
  // Radius on the ground, metres.
  double horizontal;
  // Up and down, metres.
  double vertical;
  // Rotation about the vertical, degrees.
  double yaw_deg;
} VeilocAccuracy;

// A content anchor in the AR world. Its texts are valid until the anchors are placed again or freed.
typedef struct VeilocPlacedAnchor {
  // Its name.
  const char *name;
  // Its content, JSON in UTF-8.
  const char *content;
  // Its pose, in the axes and units of the framework.
  struct VeilocPose world_from_anchor;
  // Its distance from the camera, metres.
  double distance;
} VeilocPlacedAnchor;

// The numbers of an answer.
typedef struct VeilocAnswerInfo {
  // Whether it has a pose. Doubtful poses are withheld when the request asks for it.
  bool has_pose;
  // Whether there are no doubts about the pose.
  bool trusted;
  // Standard deviation of the position in its least certain direction, map units; infinite without a pose. Relative
  // to the map, not to the earth.
  double position_sd;
  // Metres of a unit of the map; 0 when the unit is not known.
  double metres_per_unit;
  // Direction of gravity in the map, a unit vector; zeros when the map does not know it.
  double down[3];
  // Rows that agree with the pose.
  uint32_t inliers;
  // Rows that were matched to map points.
  uint32_t matches;
  // Doubts: bit 0 other, 1 weak evidence, 2 ambiguous, 3 imprecise, 4 one-sided.
  uint32_t doubts;
} VeilocAnswerInfo;

// Bytes that the library made: freed by `veiloc_bytes_free`.
typedef struct VeilocBytes {
  // The first byte; null when there are none.
  uint8_t *data;
  // How many.
  size_t length;
} VeilocBytes;

// Which frames a burst keeps, and how exact their poses are. Zero is the default of each.
typedef struct VeilocBurstOptions {
  // Most frames that are sealed together, 1 to 5; default 3. Each costs the service as much as one query.
  uint32_t frames;
  // How far back the frames reach, seconds; default 1.
  double window;
  // Standard deviation of the rotation between one kept frame and the next, degrees; default 0.1: of the tracking of
  // ARKit and ARCore over a second.
  double rotation_sd_deg;
  // The same of the position, metres; default 0.01.
  double translation_sd;
  // Metres of a unit of the map, as `GET /v1/maps` and every answer state it; default not known: until
  // `veiloc_burst_learn_unit` learns it, one frame is sealed at a time.
  double metres_per_unit;
} VeilocBurstOptions;

// Pixels of a frame of which nothing is sent: a byte for each, of any resolution. It shows the same as the frame, before the frame is
// turned. A mask that hides nothing is none; one that hides all is refused.
typedef struct VeilocMask {
  // The first byte of the first row.
  const uint8_t *bytes;
  // How many bytes may be read.
  size_t length;
  // A `VeilocMaskKind`.
  uint32_t kind;
  // Pixels of a row.
  uint32_t width;
  // Rows.
  uint32_t height;
  // Bytes from one row to the next; 0 when rows follow each other without a gap.
  size_t row_stride;
  // How far beyond what is marked is hidden, too, as a share of the mask's longer side; 0 for 0.02.
  float margin;
} VeilocMask;

// A frame of the camera: bytes that stay where the camera wrote them.
typedef struct VeilocFrame {
  // The first byte of the first row.
  const uint8_t *bytes;
  // How many bytes may be read.
  size_t length;
  // A `VeilocPixelFormat`.
  uint32_t format;
  // Pixels of a row.
  uint32_t width;
  // Rows.
  uint32_t height;
  // Bytes from one row to the next; 0 when rows follow each other without a gap.
  size_t row_stride;
  // Clockwise degrees that turn the frame upright, a multiple of 90. Poses are those of the turned camera: 0 for
  // the poses of ARKit and of ARCore's `Camera.getPose()`, the rotation of the display for AR Foundation and
  // `getDisplayOrientedPose()`.
  int32_t turn_degrees;
  // People and what else must not be sent; null for none.
  const struct VeilocMask *mask;
} VeilocFrame;

// A camera of COLMAP's models. The size is that of the frame as the sensor gives it, before it is turned.
typedef struct VeilocCamera {
  // Name of the model, for example `PINHOLE` (fx, fy, cx, cy), `OPENCV` (and k1, k2, p1, p2).
  const char *model;
  // Width, pixels.
  uint32_t width;
  // Height, pixels.
  uint32_t height;
  // Parameters in COLMAP's order, pixels; the centre of the first pixel is at (0.5, 0.5).
  double params[16];
  // How many of them the model has.
  uint32_t param_count;
  // A `VeilocFocal`.
  uint32_t focal;
} VeilocCamera;

// What is known about a burst that was sealed.
typedef struct VeilocSealedBurstInfo {
  // Frames that were sealed.
  uint32_t frames;
  // Frames that could not be sealed.
  uint32_t left_out;
  // The newest frame that was sealed, for `veiloc_advice`. It has no steps.
  struct VeilocQueryInfo newest;
} VeilocSealedBurstInfo;

// How frames are sealed: the device's choice. All zeros are the defaults.
typedef struct VeilocOptions {
  // `dcl` (also for null), its layouts, `random-lines` or `coordinate-permutation`.
  const char *scheme;
  // Most rows to send; 0 for what the profile asks, at most 2048.
  uint32_t max_keypoints;
  // Longest side to which frames are scaled down, pixels; 0 for what the profile asks, at most 2048.
  uint32_t max_image_side;
  // Bits of an angle; 0 for 12.
  uint32_t angle_bits;
  // The direction of gravity is sent, rounded to about a degree, where the pose of the camera is known, unless this is
  // true. Set it for a world whose vertical is not gravity, unlike those of ARKit and ARCore.
  bool without_gravity;
  // The pack of the map: nothing is sent that the place does not know. Null: all descriptors are sent. It may be freed
  // when the sealer is made.
  const struct VeilocPack *pack;
  // What is sent with a pack: a `VeilocPackUse`.
  uint32_t send;
} VeilocOptions;

// Counts of a session.
typedef struct VeilocSessionInfo {
  // Frames that were sealed.
  uint32_t frames;
  // How often new anchors were chosen.
  uint32_t starts;
} VeilocSessionInfo;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The advice for the last frame.
//
// - `query`: null when the frame could not be sealed.
// - `answer`: null when there was none, or the service found no pose.
// - `degrees_per_second`: rotation of the camera while it took the frame; 0 when it is not known.
// - `misses`: how many frames in a row the service found no pose for.
enum VeilocAdvice veiloc_advice(const struct VeilocQueryInfo *query,
                                const struct VeilocAnswer *answer,
                                double degrees_per_second,
                                uint32_t misses);

// A sentence for the user, in English; null for a number that is no advice.
const char *veiloc_advice_text(uint32_t advice);

// Begins an alignment. `metres_per_unit`: of the map; 0 for the unit that the answers state.
enum VeilocStatus veiloc_alignment_new(double metres_per_unit, struct VeilocAlignment **out);

// Takes an answer and the pose of the camera **when it took the frame that was sealed**, not its pose now.
enum VeilocStatus veiloc_alignment_add(struct VeilocAlignment *alignment,
                                       const struct VeilocAnswer *answer,
                                       uint32_t pose_axes,
                                       const struct VeilocPose *camera_in_world,
                                       enum VeilocUpdate *out);

// The numbers of an alignment; zeros for null.
struct VeilocAlignmentInfo veiloc_alignment_info(const struct VeilocAlignment *alignment);

// The pose in the AR world of content whose pose in the map is known (map units, x y z w). `NotAligned` before the
// first trusted answer.
enum VeilocStatus veiloc_alignment_world_from_anchor(const struct VeilocAlignment *alignment,
                                                     uint32_t pose_axes,
                                                     const struct VeilocPose *map_from_anchor,
                                                     struct VeilocPose *out);

// Where the camera is in the map now, by its pose in the AR world: position in map units, and the rotation from the
// camera's axes (COLMAP's: x right, y down, z forward) to the map's. `accuracy` may be null.
enum VeilocStatus veiloc_alignment_camera_in_map(const struct VeilocAlignment *alignment,
                                                 uint32_t pose_axes,
                                                 const struct VeilocPose *camera_in_world,
                                                 struct VeilocPose *out,
                                                 struct VeilocAccuracy *accuracy);

// Takes the pose of the camera between answers, once or twice a second: the length of its path tells how far the AR
// framework may have drifted.
enum VeilocStatus veiloc_alignment_moved(struct VeilocAlignment *alignment,
                                         uint32_t pose_axes,
                                         const struct VeilocPose *camera_in_world);

// Forgets all answers: for a new AR session, or when the framework says that it lost its world.
void veiloc_alignment_reset(struct VeilocAlignment *alignment);

// Frees an alignment.
void veiloc_alignment_free(struct VeilocAlignment *alignment);

// Reads content anchors: the body of status 200. `VEILOC_STATUS_ANSWER` for anything else.
enum VeilocStatus veiloc_anchors_new(const uint8_t *bytes, size_t length, struct VeilocAnchors **out);

// Places the anchors in the AR world, the nearest to the camera first: again after each answer. `count` gets how many there are,
// for `veiloc_anchors_get`; none before the first trusted answer.
enum VeilocStatus veiloc_anchors_place(struct VeilocAnchors *anchors,
                                       const struct VeilocAlignment *alignment,
                                       uint32_t pose_axes,
                                       const struct VeilocPose *camera_in_world,
                                       size_t *count);

// One of the placed anchors; 0 is the nearest.
enum VeilocStatus veiloc_anchors_get(const struct VeilocAnchors *anchors,
                                     size_t index,
                                     struct VeilocPlacedAnchor *out);

// Frees anchors.
void veiloc_anchors_free(struct VeilocAnchors *anchors);

// Reads an answer: the body of status 200 to a request with `accept: application/x-protobuf`.
enum VeilocStatus veiloc_answer_new(const uint8_t *bytes, size_t length, struct VeilocAnswer **out);

// The numbers of an answer; zeros for null.
struct VeilocAnswerInfo veiloc_answer_info(const struct VeilocAnswer *answer);

// Whether a progressive query ends with this answer: it is trusted and, for `position_sd` above 0, its standard
// deviation is at most that many map units.
bool veiloc_answer_is_enough(const struct VeilocAnswer *answer,
                             double position_sd);

// The answer as JSON, UTF-8 without a final zero: the document that the service gives for `accept: application/json`.
enum VeilocStatus veiloc_answer_json(const struct VeilocAnswer *answer,
                                     struct VeilocBytes *out);

// Where the camera is in the map, with the axes of a framework in place of the map's: for apps that draw the map. For
// content in the AR world use an alignment. `metres_per_unit`: 0 for the unit that the answer states.
enum VeilocStatus veiloc_answer_camera_in_map(const struct VeilocAnswer *answer,
                                              uint32_t pose_axes,
                                              double metres_per_unit,
                                              struct VeilocPose *out);

// Radii of 68 % confidence of one answer. `camera_in_world`: the pose of the camera when it took the frame, in axes
// whose vertical is gravity. `metres_per_unit`: 0 for the unit that the answer states.
enum VeilocStatus veiloc_answer_accuracy(const struct VeilocAnswer *answer,
                                         uint32_t pose_axes,
                                         const struct VeilocPose *camera_in_world,
                                         double metres_per_unit,
                                         struct VeilocAccuracy *out);

// Frees an answer.
void veiloc_answer_free(struct VeilocAnswer *answer);

// Begins a burst without frames. `options`: null for the defaults.
enum VeilocStatus veiloc_burst_new(const struct VeilocBurstOptions *options, struct VeilocBurst **out);

// Takes the unit of the map from an answer, unless the options gave one. Call it with every answer.
enum VeilocStatus veiloc_burst_learn_unit(const struct VeilocBurst *burst, const struct VeilocAnswer *answer);

// Takes a frame of the camera if it is the sharpest of its part of the window so far. Offer every frame while the AR
// framework tracks the camera.
//
// - `camera`: null for a guessed focal length.
// - `camera_in_world`: the pose of the camera when it took the frame, in `pose_axes` (a `VeilocAxes`).
// - `timestamp`: seconds of any clock that does not jump, when the camera took the frame.
enum VeilocStatus veiloc_burst_offer(const struct VeilocBurst *burst,
                                     const struct VeilocFrame *frame,
                                     const struct VeilocCamera *camera_of_frame,
                                     uint32_t pose_axes,
                                     const struct VeilocPose *camera_in_world,
                                     double timestamp);

// Frames that `veiloc_burst_seal` would seal; 0 for null.
uint32_t veiloc_burst_frames(const struct VeilocBurst *burst);

// Drops the frames: for a new AR session, or when the framework says that it lost its world. Does nothing for null.
void veiloc_burst_clear(const struct VeilocBurst *burst);

// Seals the frames in the session of their place, and forgets them. A frame that cannot be sealed is left out.
// `cancellation`: as for `veiloc_sealer_extract`.
//
// Fails when no frame can be sealed; the session has not changed then, and the frames are gone.
enum VeilocStatus veiloc_burst_seal(const struct VeilocBurst *burst,
                                    const struct VeilocSealer *sealer,
                                    struct VeilocSession *session,
                                    const struct VeilocCancellation *cancellation,
                                    struct VeilocSealedBurst **out);

// Frees a burst.
void veiloc_burst_free(struct VeilocBurst *burst);

// The bytes of a sealed burst, for `POST /v1/maps/{map}/localize-rig`: all that leaves the device. After a network
// error, send the same bytes again.
enum VeilocStatus veiloc_sealed_burst_bytes(const struct VeilocSealedBurst *sealed,
                                            struct VeilocBytes *out);

// The pose of the camera when it took the newest frame of the burst: with the answer, for `veiloc_alignment_add`.
enum VeilocStatus veiloc_sealed_burst_camera_in_world(const struct VeilocSealedBurst *sealed,
                                                      uint32_t pose_axes,
                                                      struct VeilocPose *out);

// What is known about a sealed burst; zeros for null.
struct VeilocSealedBurstInfo veiloc_sealed_burst_info(const struct VeilocSealedBurst *sealed);

// Frees a sealed burst.
void veiloc_sealed_burst_free(struct VeilocSealedBurst *sealed);

// Frees bytes that the library made. Bytes without data may be freed.
void veiloc_bytes_free(struct VeilocBytes bytes);

// A calibrated camera without distortion, from the numbers of ARKit's and ARCore's intrinsics. Focal lengths and
// principal point in pixels of the frame.
struct VeilocCamera veiloc_camera_pinhole(uint32_t width,
                                          uint32_t height,
                                          double fx,
                                          double fy,
                                          double cx,
                                          double cy);

// The camera of a part of the image, `width` x `height` pixels with its first pixel at column `x`, row `y`: for
// passthrough cameras of headsets, whose smaller images are parts of the sensor's. `out` may be `camera`.
enum VeilocStatus veiloc_camera_cropped(const struct VeilocCamera *camera,
                                        uint32_t x,
                                        uint32_t y,
                                        uint32_t width,
                                        uint32_t height,
                                        struct VeilocCamera *out);

// Makes a request that was not made yet. Free it after the calls that it was given to.
enum VeilocStatus veiloc_cancellation_new(struct VeilocCancellation **out);

// Makes the request: calls that were given it, running and later ones, fail with `Cancelled`. It cannot be revoked. Does
// nothing for null.
void veiloc_cancel(const struct VeilocCancellation *cancellation);

// Frees a request.
void veiloc_cancellation_free(struct VeilocCancellation *cancellation);

// Reads a pack and prepares it, which takes about a millisecond per thousand rows: call it on a thread of its own, once.
enum VeilocStatus veiloc_pack_new(const uint8_t *bytes,
                                  size_t length,
                                  struct VeilocPack **out);

// The id of the pack, 32 hexadecimal digits: the operator publishes it, and an app that compares it notices a pack that
// was made for one device. Valid as long as the pack; null for null.
const char *veiloc_pack_id(const struct VeilocPack *pack);

// The profile of the map, which a pack contains: an app that has the pack need not fetch it.
enum VeilocStatus veiloc_pack_profile(const struct VeilocPack *pack, struct VeilocProfile **out);

// Frees a pack. Sealers that were made with it stay usable.
void veiloc_pack_free(struct VeilocPack *pack);

// A pose from the columns of a 4 x 4 matrix: `simd_float4x4` of ARKit, `Pose.toMatrix` of ARCore, WebXR's `matrix`.
enum VeilocStatus veiloc_pose_from_matrix(const double *columns,
                                          struct VeilocPose *out);

// The pose of what is mounted on an object, such as the camera of a headset on the head: the pose of the object in the
// world, and that of the mounted one in the object's axes (the lens offset). Both in the same axes and units.
enum VeilocStatus veiloc_pose_composed(const struct VeilocPose *object,
                                       const struct VeilocPose *mounted,
                                       struct VeilocPose *out);

// Reads a profile.
enum VeilocStatus veiloc_profile_new(const uint8_t *bytes, size_t length, struct VeilocProfile **out);

// The id of the profile, 32 hexadecimal digits: the operator publishes it, and an app that compares it notices a
// profile that was made for one device. Valid as long as the profile; null for null.
const char *veiloc_profile_id(const struct VeilocProfile *profile);

// Frees a profile. Sealers that were made with it stay usable.
void veiloc_profile_free(struct VeilocProfile *profile);

// What is known about a query; zeros for null.
struct VeilocQueryInfo veiloc_query_info(const struct VeilocQuery *query);

// The bytes of a query, for `POST /v1/maps/{map}/localize`: all that leaves the device. `rows`: 0 for all rows, or a
// step of `VeilocQueryInfo`. After a network error, send the same bytes again.
enum VeilocStatus veiloc_query_bytes(const struct VeilocQuery *query,
                                     uint32_t rows,
                                     struct VeilocBytes *out);

// Frees a query.
void veiloc_query_free(struct VeilocQuery *query);

// Several queries of one device and their poses, for `POST /v1/maps/{map}/localize-rig`: localized together. The answer
// is the pose of the first camera.
//
// `queries` and `cameras_in_world` hold `count` (1 to 32) pointers and poses. Only poses relative to the first are
// sent. `rotation_sd_deg` and `translation_sd` (metres): how exact the AR framework's poses are.
enum VeilocStatus veiloc_rig_bytes(const struct VeilocQuery *const *queries,
                                   uint32_t pose_axes,
                                   const struct VeilocPose *cameras_in_world,
                                   size_t count,
                                   double metres_per_unit,
                                   double rotation_sd_deg,
                                   double translation_sd,
                                   struct VeilocBytes *out);

// Makes a sealer: checks what the profile asks for. `options`: null for the defaults.
enum VeilocStatus veiloc_sealer_new(const struct VeilocProfile *profile,
                                    const struct VeilocOptions *sealer_options,
                                    struct VeilocSealer **out);

// Extracts the features of a frame.
//
// - `camera_of_frame`: null for a guessed focal length.
// - `camera_in_world`: the pose of the camera when it took the frame, in `pose_axes` (a `VeilocAxes`); null when it
//   is not known. It stays on the device, except for gravity (`VeilocOptions`).
// - `cancellation`: a request that another thread may make to stop the call; null for none.
enum VeilocStatus veiloc_sealer_extract(const struct VeilocSealer *sealer,
                                        const struct VeilocFrame *frame,
                                        const struct VeilocCamera *camera_of_frame,
                                        uint32_t pose_axes,
                                        const struct VeilocPose *camera_in_world,
                                        const struct VeilocCancellation *cancellation,
                                        struct VeilocExtracted **out);

// Seals the features of a frame, once: they are used up then, also when it fails. The handle is still to be freed.
//
// `session`: null for a frame of its own. Frames of one place belong to one session.
//
// Fails with `Unbalanced` when the query could not determine a pose, and with `NotThisPlace` when the frame does not show
// the place of the pack. The session has not changed after any error, so another frame costs nothing.
enum VeilocStatus veiloc_sealer_seal(const struct VeilocSealer *sealer,
                                     struct VeilocSession *session,
                                     struct VeilocExtracted *extracted,
                                     struct VeilocQuery **out);

#if defined(VEILOC_SEEDED)
// As `veiloc_sealer_seal`, with 32 bytes of randomness: for tests that compare queries. A query whose seed is known
// hides nothing.
enum VeilocStatus veiloc_sealer_seal_seeded(const struct VeilocSealer *sealer,
                                            struct VeilocSession *session,
                                            struct VeilocExtracted *extracted,
                                            const uint8_t *seed,
                                            struct VeilocQuery **out);
#endif

// Frees a sealer. Queries that it sealed stay usable.
void veiloc_sealer_free(struct VeilocSealer *sealer);

// Frees the features of a frame.
void veiloc_extracted_free(struct VeilocExtracted *extracted);

// Begins a session. `anchors`: `world` (also for null), `gravity` or `image`.
enum VeilocStatus veiloc_session_new(const char *anchors, struct VeilocSession **out);

// Reads a session that `veiloc_session_to_bytes` wrote.
enum VeilocStatus veiloc_session_from_bytes(const uint8_t *bytes, size_t length, struct VeilocSession **out);

// The session as bytes, to go on after the app was closed. They hold positions of keypoints: keep them in the app's
// private storage, and never send them.
enum VeilocStatus veiloc_session_to_bytes(const struct VeilocSession *session,
                                          struct VeilocBytes *out);

// Counts of a session; zeros for null.
struct VeilocSessionInfo veiloc_session_info(const struct VeilocSession *session);

// Frees a session.
void veiloc_session_free(struct VeilocSession *session);

// The message of the last call of this thread that failed, in English; empty before one. Valid until the next call of
// this thread fails.
const char *veiloc_last_error(void);

// The version of the library.
const char *veiloc_version(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* VEILOC_H */
