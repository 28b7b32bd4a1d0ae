/*
 * Seals raw frames with given seeds and compares the queries with those that the library made of the image files
 * (bindings/c/examples/reference.rs): every bit is equal. Then it makes errors, and seals the first frame many times, scaled
 * down, for a leak checker; the heap must not grow.
 *
 *     seals PROFILE FRAMES_FOLDER REPEAT
 */
#include <malloc.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define VEILOC_SEEDED
#include "veiloc.h"

static uint8_t *read_file(const char *folder, const char *name, size_t *length) {
  char path[1024];
  FILE *file;
  uint8_t *bytes = NULL;
  long end;
  snprintf(path, sizeof path, "%s%s%s", folder, *folder ? "/" : "", name);
  file = fopen(path, "rb");
  if (!file) {
    fprintf(stderr, "%s: cannot be read\n", path);
    exit(1);
  }
  fseek(file, 0, SEEK_END);
  end = ftell(file);
  fseek(file, 0, SEEK_SET);
  bytes = malloc((size_t)end + 1);
  *length = fread(bytes, 1, (size_t)end, file);
  bytes[*length] = 0;
  fclose(file);
  return bytes;
}

static void expect(int is_true, const char *what) {
  if (!is_true) {
    fprintf(stderr, "failed: %s (%s)\n", what, veiloc_last_error());
    exit(1);
  }
}

static VeilocSealer *sealer_of(const VeilocProfile *profile, const VeilocOptions *options) {
  VeilocSealer *sealer = NULL;
  expect(veiloc_sealer_new(profile, options, &sealer) == VEILOC_STATUS_OK, "a sealer");
  return sealer;
}

/* Extracts and seals a frame, as an app does. */
static VeilocStatus seal(const VeilocSealer *sealer, VeilocSession *session, const VeilocFrame *frame, const VeilocCamera *camera,
                         uint32_t axes, const VeilocPose *pose, const VeilocCancellation *cancellation, VeilocQuery **query) {
  VeilocExtracted *extracted = NULL;
  VeilocStatus status = veiloc_sealer_extract(sealer, frame, camera, axes, pose, cancellation, &extracted);
  if (status == VEILOC_STATUS_OK) {
    VeilocQuery *again = NULL;
    status = veiloc_sealer_seal(sealer, session, extracted, query);
    expect(veiloc_sealer_seal(sealer, session, extracted, &again) == VEILOC_STATUS_ARGUMENT && !again, "a frame is sealed once");
  }
  veiloc_extracted_free(extracted);
  return status;
}

/* The query of a frame, compared with the reference. */
static void compare(const VeilocSealer *sealer, const VeilocFrame *frame, const VeilocCamera *camera, int number,
                    const uint8_t *expected, size_t expected_length) {
  uint8_t seed[32];
  VeilocExtracted *extracted = NULL;
  VeilocQuery *query = NULL;
  VeilocQueryInfo info;
  VeilocBytes bytes;
  memset(seed, number & 255, sizeof seed);
  expect(veiloc_sealer_extract(sealer, frame, camera, 0, NULL, NULL, &extracted) == VEILOC_STATUS_OK, "extracts");
  expect(veiloc_sealer_seal_seeded(sealer, NULL, extracted, seed, &query) == VEILOC_STATUS_OK, "seals");
  veiloc_extracted_free(extracted);
  info = veiloc_query_info(query);
  expect(info.rows >= 256 && info.step_count >= 1 && info.steps[info.step_count - 1] == info.rows, "has steps");
  expect(veiloc_query_bytes(query, 0, &bytes) == VEILOC_STATUS_OK, "gives bytes");
  expect(bytes.length == expected_length && memcmp(bytes.data, expected, expected_length) == 0, "equals the reference");
  veiloc_bytes_free(bytes);
  expect(veiloc_query_bytes(query, info.steps[0], &bytes) == VEILOC_STATUS_OK, "gives a step");
  expect(bytes.length <= expected_length, "a step is not longer than the query");
  veiloc_bytes_free(bytes);
  expect(veiloc_query_bytes(query, 257, &bytes) == VEILOC_STATUS_ARGUMENT, "refuses rows that are no step");
  veiloc_query_free(query);
}

/* Nothing under a mask reaches the query (rule L13): a frame with other pixels there gives the query of the reference. */
static void masks(const VeilocSealer *sealer, const char *folder, const VeilocFrame *frame, const VeilocCamera *camera) {
  size_t length, expected_length;
  uint8_t *labels = read_file(folder, "mask", &length), *expected = read_file(folder, "masked", &expected_length), *other;
  uint8_t seed[32] = {0};
  VeilocMask mask = {0};
  VeilocFrame hidden = *frame;
  VeilocExtracted *extracted = NULL;
  VeilocQuery *query = NULL;
  VeilocBytes bytes;
  other = read_file(folder, "hidden.rgba", &hidden.length);
  hidden.bytes = other;
  hidden.mask = &mask;
  mask.bytes = labels;
  mask.length = length;
  mask.kind = VEILOC_MASK_KIND_ARCORE_SEMANTICS;
  mask.width = 40;
  mask.height = 30;
  mask.row_stride = 48;
  expect(veiloc_sealer_extract(sealer, &hidden, camera, 0, NULL, NULL, &extracted) == VEILOC_STATUS_OK, "extracts under a mask");
  expect(veiloc_sealer_seal_seeded(sealer, NULL, extracted, seed, &query) == VEILOC_STATUS_OK, "seals under a mask");
  expect(veiloc_query_bytes(query, 0, &bytes) == VEILOC_STATUS_OK, "gives bytes");
  expect(bytes.length == expected_length && !memcmp(bytes.data, expected, expected_length), "nothing under the mask is sent");
  veiloc_bytes_free(bytes);
  veiloc_query_free(query);
  veiloc_extracted_free(extracted);
  extracted = NULL;
  mask.kind = 9;
  expect(veiloc_sealer_extract(sealer, &hidden, camera, 0, NULL, NULL, &extracted) == VEILOC_STATUS_ARGUMENT, "a kind");
  mask.kind = VEILOC_MASK_KIND_MARKED;
  mask.length = 100;
  expect(veiloc_sealer_extract(sealer, &hidden, camera, 0, NULL, NULL, &extracted) == VEILOC_STATUS_IMAGE, "a short mask");
  mask.length = length;
  mask.margin = 1;
  expect(veiloc_sealer_extract(sealer, &hidden, camera, 0, NULL, NULL, &extracted) == VEILOC_STATUS_IMAGE, "all is hidden");
  free(labels);
  free(expected);
  free(other);
}

static void errors(const VeilocProfile *profile, const VeilocSealer *sealer, const VeilocFrame *frame, const VeilocCamera *camera) {
  VeilocFrame other = *frame;
  VeilocCamera wrong = *camera;
  VeilocProfile *no_profile = NULL;
  VeilocSealer *no_sealer = NULL;
  VeilocOptions options = {0};
  VeilocSession *no_session = NULL;
  VeilocAnswer *no_answer = NULL;
  VeilocQuery *query = NULL;
  VeilocPose pose = {{0, 0, 0}, {0, 0, 0, 0}};
  uint8_t *flat = calloc((size_t)frame->width * frame->height, 1);
  expect(veiloc_profile_new((const uint8_t *)"no profile", 10, &no_profile) == VEILOC_STATUS_PROFILE && !no_profile, "a profile");
  expect(strlen(veiloc_last_error()) > 10, "has a message");
  expect(veiloc_profile_new(NULL, 5, &no_profile) == VEILOC_STATUS_ARGUMENT, "null bytes");
  expect(veiloc_answer_new(NULL, 0, &no_answer) == VEILOC_STATUS_ANSWER, "an empty answer");
  expect(veiloc_session_from_bytes((const uint8_t *)"x", 1, &no_session) == VEILOC_STATUS_SESSION, "a session");
  expect(veiloc_session_new("nowhere", &no_session) == VEILOC_STATUS_ARGUMENT, "anchors");
  expect(veiloc_sealer_new(NULL, NULL, &no_sealer) == VEILOC_STATUS_ARGUMENT && !no_sealer, "no profile");
  options.scheme = "points";
  expect(veiloc_sealer_new(profile, &options, &no_sealer) == VEILOC_STATUS_SEAL && !no_sealer, "points");
  expect(seal(NULL, NULL, frame, camera, 0, NULL, NULL, &query) == VEILOC_STATUS_ARGUMENT, "no sealer");
  expect(veiloc_sealer_seal(sealer, NULL, NULL, &query) == VEILOC_STATUS_ARGUMENT, "no features");
  expect(seal(sealer, NULL, frame, camera, 9, &pose, NULL, &query) == VEILOC_STATUS_ARGUMENT, "axes");
  expect(seal(sealer, NULL, frame, camera, 0, &pose, NULL, &query) == VEILOC_STATUS_ARGUMENT, "no rotation");
  other.length--;
  expect(seal(sealer, NULL, &other, camera, 0, NULL, NULL, &query) == VEILOC_STATUS_IMAGE, "a short frame");
  other = *frame;
  other.turn_degrees = 45;
  expect(seal(sealer, NULL, &other, camera, 0, NULL, NULL, &query) == VEILOC_STATUS_ARGUMENT, "a turn of 45");
  other = *frame;
  other.format = 7;
  expect(seal(sealer, NULL, &other, camera, 0, NULL, NULL, &query) == VEILOC_STATUS_ARGUMENT, "a format");
  wrong.width++;
  expect(seal(sealer, NULL, frame, &wrong, 0, NULL, NULL, &query) == VEILOC_STATUS_IMAGE, "another size");
  wrong = *camera;
  wrong.param_count = 99;
  expect(seal(sealer, NULL, frame, &wrong, 0, NULL, NULL, &query) == VEILOC_STATUS_ARGUMENT, "99 parameters");
  other = *frame;
  other.bytes = flat;
  other.length = (size_t)frame->width * frame->height;
  other.format = VEILOC_PIXEL_FORMAT_GRAY;
  expect(seal(sealer, NULL, &other, camera, 0, NULL, NULL, &query) == VEILOC_STATUS_TEXTURE, "a black frame");
  expect(veiloc_sealer_extract(sealer, frame, camera, 0, NULL, NULL, NULL) == VEILOC_STATUS_ARGUMENT, "no out");
  expect(query == NULL, "no query was made");
  expect(veiloc_advice(NULL, NULL, 0, 0) == VEILOC_ADVICE_SHOW_MORE_DETAIL, "an advice");
  expect(veiloc_advice_text(99) == NULL && strlen(veiloc_advice_text(VEILOC_ADVICE_READY)) > 5, "texts");
  veiloc_profile_free(NULL);
  veiloc_sealer_free(NULL);
  veiloc_extracted_free(NULL);
  veiloc_session_free(NULL);
  veiloc_query_free(NULL);
  veiloc_answer_free(NULL);
  veiloc_alignment_free(NULL);
  free(flat);
}

/*
 * The first frame sealed with the pack: equal to the reference, or refused where the frame does not show the place. The pack may be
 * freed before the sealer.
 */
static void packs(const char *folder, const VeilocFrame *frame, const VeilocCamera *camera) {
  size_t length, expected_length;
  uint8_t *bytes = read_file(folder, "pack", &length), *expected = read_file(folder, "matched", &expected_length);
  VeilocPack *pack = NULL;
  VeilocProfile *profile = NULL;
  VeilocSealer *sealer, *none = NULL;
  VeilocExtracted *extracted = NULL;
  VeilocQuery *query = NULL;
  VeilocOptions options = {0};
  VeilocBytes sealed;
  VeilocStatus status;
  const uint8_t seed[32] = {0};
  VeilocFrame squares = *frame;
  uint8_t *gray = malloc((size_t)frame->width * frame->height);
  expect(veiloc_pack_new(bytes, length - 1, &pack) == VEILOC_STATUS_PACK && !pack, "a damaged pack");
  expect(veiloc_pack_new(NULL, 5, &pack) == VEILOC_STATUS_ARGUMENT && !pack, "null bytes");
  expect(veiloc_pack_new(bytes, length, &pack) == VEILOC_STATUS_OK, "a pack");
  expect(veiloc_pack_profile(NULL, &profile) == VEILOC_STATUS_ARGUMENT && !profile, "the profile of no pack");
  expect(veiloc_pack_profile(pack, &profile) == VEILOC_STATUS_OK, "its profile");
  expect(strlen(veiloc_pack_id(pack)) == 32 && !veiloc_pack_id(NULL) && strlen(veiloc_profile_id(profile)) == 32, "ids");
  options.send = VEILOC_PACK_USE_EXPLAINED;
  expect(veiloc_sealer_new(profile, &options, &none) == VEILOC_STATUS_ARGUMENT && !none, "explained without a pack");
  options.pack = pack;
  options.send = 7;
  expect(veiloc_sealer_new(profile, &options, &none) == VEILOC_STATUS_ARGUMENT && !none, "a send");
  options.send = VEILOC_PACK_USE_MATCHES;
  sealer = sealer_of(profile, &options);
  veiloc_pack_free(pack);
  veiloc_pack_free(NULL);
  veiloc_profile_free(profile);
  expect(veiloc_sealer_extract(sealer, frame, camera, 0, NULL, NULL, &extracted) == VEILOC_STATUS_OK, "extracts");
  status = veiloc_sealer_seal_seeded(sealer, NULL, extracted, seed, &query);
  veiloc_extracted_free(extracted);
  if (expected_length == 0) {
    expect(status == VEILOC_STATUS_NOT_THIS_PLACE && !query, "a frame of another place");
  } else {
    expect(status == VEILOC_STATUS_OK && veiloc_query_bytes(query, 0, &sealed) == VEILOC_STATUS_OK, "seals with the pack");
    expect(sealed.length == expected_length && memcmp(sealed.data, expected, expected_length) == 0, "matches as the reference");
    veiloc_bytes_free(sealed);
  }
  veiloc_query_free(query);
  query = NULL;
  /* Two squares have fewer keypoints than a place must explain. */
  squares.bytes = gray;
  squares.length = (size_t)frame->width * frame->height;
  squares.format = VEILOC_PIXEL_FORMAT_GRAY;
  for (size_t i = 0; i < squares.length; i++) {
    size_t column = i % frame->width / 20, row = i / frame->width / 20;
    gray[i] = row == 7 && (column == 7 || column == 14) ? 30 : 200;
  }
  expect(seal(sealer, NULL, &squares, camera, 0, NULL, NULL, &query) == VEILOC_STATUS_NOT_THIS_PLACE && !query, "two squares");
  veiloc_sealer_free(sealer);
  free(gray);
  free(bytes);
  free(expected);
}

/* Another thread cancels while frames are sealed. */
static void *cancel(void *cancellation) {
  veiloc_cancel(cancellation);
  return NULL;
}

static void cancelled(const VeilocSealer *sealer, const VeilocFrame *frame, const VeilocCamera *camera) {
  VeilocCancellation *cancellation = NULL;
  VeilocSession *session = NULL;
  VeilocQuery *query = NULL;
  VeilocStatus status;
  pthread_t thread;
  expect(veiloc_cancellation_new(&cancellation) == VEILOC_STATUS_OK && veiloc_session_new(NULL, &session) == VEILOC_STATUS_OK, "a request");
  expect(seal(sealer, session, frame, camera, 0, NULL, cancellation, &query) == VEILOC_STATUS_OK, "seals until it is made");
  veiloc_query_free(query);
  expect(pthread_create(&thread, NULL, cancel, cancellation) == 0, "a thread");
  do {
    query = NULL;
    status = seal(sealer, NULL, frame, camera, 0, NULL, cancellation, &query);
    veiloc_query_free(query);
  } while (status == VEILOC_STATUS_OK);
  expect(status == VEILOC_STATUS_CANCELLED && query == NULL, "is cancelled");
  pthread_join(thread, NULL);
  expect(seal(sealer, session, frame, camera, 0, NULL, cancellation, &query) == VEILOC_STATUS_CANCELLED, "stays so");
  expect(veiloc_session_info(session).frames == 1, "the session has not changed");
  veiloc_cancel(NULL);
  veiloc_cancellation_free(cancellation);
  veiloc_session_free(session);
}

/* A session with the pose of the camera goes through bytes, and seals on. */
static void sessions(const VeilocSealer *sealer, const VeilocFrame *frame, const VeilocCamera *camera) {
  VeilocSession *session = NULL, *restored = NULL;
  VeilocQuery *query = NULL;
  VeilocBytes bytes;
  VeilocPose pose = {{1, 2, 3}, {0, 0, 0, 1}};
  expect(veiloc_session_new("gravity", &session) == VEILOC_STATUS_OK, "begins");
  expect(seal(sealer, session, frame, camera, VEILOC_AXES_UNITY, &pose, NULL, &query) == VEILOC_STATUS_OK, "seals in it");
  veiloc_query_free(query);
  query = NULL;
  expect(veiloc_session_info(session).frames == 1 && veiloc_session_info(session).starts == 1, "counts");
  expect(veiloc_session_to_bytes(session, &bytes) == VEILOC_STATUS_OK, "to bytes");
  expect(veiloc_session_from_bytes(bytes.data, bytes.length, &restored) == VEILOC_STATUS_OK, "from bytes");
  veiloc_bytes_free(bytes);
  expect(seal(sealer, restored, frame, camera, VEILOC_AXES_UNITY, &pose, NULL, &query) == VEILOC_STATUS_OK, "seals on");
  expect(veiloc_session_info(restored).frames == 2 && veiloc_session_info(session).frames == 1, "counts on");
  {
    const VeilocQuery *queries[2];
    VeilocPose poses[2] = {{{1, 2, 3}, {0, 0, 0, 1}}, {{1, 2, 4}, {0, 0, 0, 1}}};
    queries[0] = queries[1] = query;
    expect(veiloc_rig_bytes(queries, VEILOC_AXES_UNITY, poses, 2, 1.0, 0.5, 0.01, &bytes) == VEILOC_STATUS_OK, "a rig");
    expect(bytes.length > 8 && memcmp(bytes.data, "vqrig1\n\2", 8) == 0, "a rig of two frames");
    veiloc_bytes_free(bytes);
  }
  veiloc_query_free(query);
  veiloc_session_free(restored);
  veiloc_session_free(session);
}

/* A part of an image, and a lens on a head that looks back. */
static void headsets(void) {
  const VeilocPose head = {{1, 2, 3}, {0, 1, 0, 0}}, lens = {{0, 0, 0.5}, {0, 0, 0, 1}};
  VeilocPose composed;
  VeilocCamera camera = veiloc_camera_pinhole(4, 4, 1, 1, 2, 2);
  expect(veiloc_camera_cropped(&camera, 1, 0, 3, 2, &camera) == VEILOC_STATUS_OK && camera.width == 3 && camera.height == 2, "a part");
  expect(camera.params[2] == 1 && camera.params[3] == 2 && camera.param_count == 4, "its principal point");
  expect(veiloc_camera_cropped(&camera, 1, 0, 3, 2, &camera) == VEILOC_STATUS_ARGUMENT, "a part outside");
  expect(veiloc_camera_cropped(NULL, 1, 0, 3, 2, &camera) == VEILOC_STATUS_ARGUMENT, "no camera");
  expect(veiloc_pose_composed(&head, &lens, &composed) == VEILOC_STATUS_OK && composed.position[2] == 2.5, "a lens on a head");
  composed.rotation[1] = 0.0 / 0.0;
  expect(veiloc_pose_composed(&composed, &lens, &composed) == VEILOC_STATUS_ARGUMENT, "no rotation");
}

/* Bursts: the newest frame is the rig, a black one is left out, and a burst without texture leaves the session. */
static void bursts(const VeilocProfile *profile, const VeilocFrame *frame, const VeilocCamera *camera) {
  VeilocBurst *burst = NULL;
  VeilocSealedBurst *sealed = NULL;
  VeilocSealer *sealer;
  VeilocSession *session = NULL;
  VeilocBurstOptions wrong = {0}, metric = {0};
  VeilocOptions options = {0};
  VeilocFrame black = *frame;
  VeilocPose pose = {{1, 2, 3}, {0, 0, 0, 1}}, newest;
  VeilocSealedBurstInfo info;
  VeilocBytes bytes;
  uint8_t *flat = calloc((size_t)frame->width * frame->height, 1);
  black.bytes = flat;
  black.length = (size_t)frame->width * frame->height;
  black.format = VEILOC_PIXEL_FORMAT_GRAY;
  wrong.frames = 6;
  options.without_gravity = true;
  sealer = sealer_of(profile, &options);
  expect(veiloc_burst_new(&wrong, &burst) == VEILOC_STATUS_ARGUMENT && !burst, "six frames");
  metric.metres_per_unit = 1;
  expect(veiloc_burst_new(&metric, &burst) == VEILOC_STATUS_OK && veiloc_session_new(NULL, &session) == VEILOC_STATUS_OK, "begins");
  expect(veiloc_burst_seal(burst, sealer, session, NULL, &sealed) == VEILOC_STATUS_ARGUMENT, "no frame");
  expect(veiloc_burst_offer(burst, frame, camera, VEILOC_AXES_UNITY, &pose, 0.0 / 0.0) == VEILOC_STATUS_ARGUMENT, "no time");
  expect(veiloc_burst_offer(burst, frame, camera, VEILOC_AXES_UNITY, NULL, 1.0) == VEILOC_STATUS_ARGUMENT, "no pose");
  expect(veiloc_burst_offer(burst, &black, camera, VEILOC_AXES_UNITY, &pose, 1.0) == VEILOC_STATUS_OK, "takes a frame");
  expect(veiloc_burst_frames(burst) == 1 && veiloc_burst_frames(NULL) == 0, "keeps it");
  expect(veiloc_burst_seal(burst, sealer, session, NULL, &sealed) == VEILOC_STATUS_TEXTURE && !sealed, "a black burst");
  expect(veiloc_session_info(session).frames == 0 && veiloc_burst_frames(burst) == 0, "leaves the session");
  for (int i = 0; i < 3; i++) {
    pose.position[0] = 1 + 0.01 * i;
    expect(veiloc_burst_offer(burst, i == 1 ? &black : frame, camera, VEILOC_AXES_UNITY, &pose, 2 + 0.4 * i) == VEILOC_STATUS_OK, "three frames");
  }
  expect(veiloc_burst_frames(burst) == 3, "keeps three");
  expect(veiloc_burst_seal(burst, sealer, session, NULL, &sealed) == VEILOC_STATUS_OK, "seals a burst");
  info = veiloc_sealed_burst_info(sealed);
  expect(info.frames == 2 && info.left_out == 1 && info.newest.keypoints > 0 && info.newest.rows >= 256, "counts frames");
  expect(veiloc_advice(&info.newest, NULL, 0, 0) == VEILOC_ADVICE_TURN_TO_MAPPED_PLACE, "an advice for a burst");
  expect(veiloc_session_info(session).frames == 2 && veiloc_sealed_burst_info(NULL).frames == 0, "seals in the session");
  expect(veiloc_sealed_burst_camera_in_world(sealed, VEILOC_AXES_UNITY, &newest) == VEILOC_STATUS_OK, "its pose");
  for (int i = 0; i < 3; i++) {
    double off = newest.position[i] - pose.position[i];
    expect(off < 1e-9 && off > -1e-9, "that of the newest frame");
  }
  expect(veiloc_sealed_burst_bytes(sealed, &bytes) == VEILOC_STATUS_OK, "gives bytes");
  expect(bytes.length > 8 && memcmp(bytes.data, "vqrig1\n\2", 8) == 0, "a rig of two frames");
  veiloc_bytes_free(bytes);
  veiloc_sealed_burst_free(sealed);
  veiloc_burst_free(burst);
  /* In an unknown unit the distance between frames has no meaning. */
  expect(veiloc_burst_new(NULL, &burst) == VEILOC_STATUS_OK, "without a unit");
  for (int i = 0; i < 2; i++) {
    expect(veiloc_burst_offer(burst, frame, camera, VEILOC_AXES_UNITY, &pose, 4 + 0.8 * i) == VEILOC_STATUS_OK, "two frames");
  }
  expect(veiloc_burst_learn_unit(burst, NULL) == VEILOC_STATUS_ARGUMENT, "no answer");
  expect(veiloc_burst_seal(burst, sealer, session, NULL, &sealed) == VEILOC_STATUS_OK, "seals one frame");
  info = veiloc_sealed_burst_info(sealed);
  expect(info.frames == 1 && info.left_out == 0, "one frame");
  veiloc_burst_clear(burst);
  veiloc_burst_clear(NULL);
  veiloc_burst_free(burst);
  veiloc_burst_free(NULL);
  veiloc_sealed_burst_free(sealed);
  veiloc_sealed_burst_free(NULL);
  veiloc_sealer_free(sealer);
  veiloc_session_free(session);
  free(flat);
}

/*
 * Seals as an app does, again and again: a small frame alone or in a session, its bytes and those of a step, an error, and
 * answers that are none. After a tenth of the seals the heap in use stays within 256 kB.
 */
static void repeatedly(const VeilocProfile *profile, const VeilocFrame *frame, const VeilocCamera *camera, int repeat) {
  VeilocSession *session = NULL;
  VeilocOptions options = {0};
  VeilocSealer *sealer;
  size_t settled = 0;
  options.max_image_side = 192;
  options.max_keypoints = 256;
  sealer = sealer_of(profile, &options);
  for (int i = 0; i < repeat; i++) {
    VeilocPose pose = {{0.01 * (i % 7), 0, 0}, {0, 0, 0, 1}};
    VeilocQuery *query = NULL;
    VeilocAnswer *answer = NULL;
    VeilocBytes bytes;
    VeilocStatus status;
    /* Sessions that rest, of five frames each. */
    if (i % 5 == 0) {
      veiloc_session_free(session);
      session = NULL;
      expect(veiloc_session_new("gravity", &session) == VEILOC_STATUS_OK, "begins");
    }
    status = seal(sealer, i % 2 ? session : NULL, frame, camera, VEILOC_AXES_OPEN_GL, &pose, NULL, &query);
    /* A repeated frame may have too few new rows for a pose. */
    expect(status == VEILOC_STATUS_OK || (i % 2 && status == VEILOC_STATUS_UNBALANCED), "seals a small frame");
    if (status == VEILOC_STATUS_OK) {
      VeilocQueryInfo info = veiloc_query_info(query);
      expect(veiloc_query_bytes(query, 0, &bytes) == VEILOC_STATUS_OK && bytes.length > 1000, "gives bytes");
      expect(veiloc_answer_new(bytes.data, bytes.length, &answer) == VEILOC_STATUS_ANSWER, "a query is no answer");
      veiloc_bytes_free(bytes);
      expect(veiloc_query_bytes(query, info.steps[0], &bytes) == VEILOC_STATUS_OK, "gives a step");
      veiloc_bytes_free(bytes);
      expect(veiloc_query_bytes(query, 3, &bytes) == VEILOC_STATUS_ARGUMENT, "refuses 3 rows");
    }
    veiloc_query_free(query);
    if (i == repeat / 10) settled = mallinfo2().uordblks;
  }
  veiloc_session_free(session);
  veiloc_sealer_free(sealer);
  if (repeat >= 100) {
    size_t end = mallinfo2().uordblks;
    fprintf(stderr, "heap in use after %d seals: %zu bytes, after %d: %zu bytes\n", repeat / 10, settled, repeat, end);
    /* The address sanitizer has a heap of its own, and its leak checker reports at the end. */
    expect(end < settled + (256 << 10), "the heap does not grow");
  }
}

/* The document of an answer is the one that the service gives. */
static void same_document(const char *folder) {
  size_t length, expected_length;
  uint8_t *bytes = read_file(folder, "answer", &length), *expected = read_file(folder, "answer.json", &expected_length);
  VeilocAnswer *answer = NULL;
  VeilocAnswerInfo info;
  VeilocBytes json;
  expect(veiloc_answer_new(bytes, length, &answer) == VEILOC_STATUS_OK, "an answer");
  expect(veiloc_answer_json(answer, &json) == VEILOC_STATUS_OK, "its document");
  expect(json.length == expected_length && memcmp(json.data, expected, expected_length) == 0, "the same document");
  info = veiloc_answer_info(answer);
  expect(info.metres_per_unit == 1 && info.down[1] == -1, "unit and down");
  veiloc_bytes_free(json);
  veiloc_answer_free(answer);
  free(bytes);
  free(expected);
}

int main(int argc, char **argv) {
  size_t length;
  uint8_t *bytes, *list;
  VeilocProfile *profile = NULL;
  VeilocSealer *sealer;
  int count = 0, repeat;
  if (argc != 4) return 2;
  repeat = atoi(argv[3]);
  bytes = read_file("", argv[1], &length);
  expect(veiloc_profile_new(bytes, length, &profile) == VEILOC_STATUS_OK, "a profile");
  expect(strlen(veiloc_profile_id(profile)) == 32, "an id");
  sealer = sealer_of(profile, NULL);
  free(bytes);
  same_document(argv[2]);
  list = read_file(argv[2], "frames.txt", &length);
  for (char *line = strtok((char *)list, "\n"); line; line = strtok(NULL, "\n")) {
    VeilocFrame frame = {0};
    VeilocCamera camera = {0};
    char model[64], name[80];
    int number, at = 0, step;
    size_t expected_length, pixels_length;
    uint8_t *expected, *pixels;
    expect(sscanf(line, "%d %u %u %63s%n", &number, &camera.width, &camera.height, model, &at) == 4, "a line");
    while (sscanf(line + at, "%lf%n", &camera.params[camera.param_count], &step) == 1) {
      at += step;
      if (++camera.param_count == 16) break;
    }
    camera.model = model;
    snprintf(name, sizeof name, "%d.rgba", number);
    pixels = read_file(argv[2], name, &pixels_length);
    snprintf(name, sizeof name, "%d.query", number);
    expected = read_file(argv[2], name, &expected_length);
    frame.bytes = pixels;
    frame.length = pixels_length;
    frame.format = VEILOC_PIXEL_FORMAT_RGBA;
    frame.width = camera.width;
    frame.height = camera.height;
    compare(sealer, &frame, &camera, number, expected, expected_length);
    if (count == 0) {
      errors(profile, sealer, &frame, &camera);
      masks(sealer, argv[2], &frame, &camera);
      packs(argv[2], &frame, &camera);
      sessions(sealer, &frame, &camera);
      bursts(profile, &frame, &camera);
      headsets();
      cancelled(sealer, &frame, &camera);
      repeatedly(profile, &frame, &camera, repeat);
    }
    count++;
    free(pixels);
    free(expected);
  }
  free(list);
  veiloc_sealer_free(sealer);
  veiloc_profile_free(profile);
  printf("%d queries equal, %d repeated\n", count, repeat);
  return count > 0 ? 0 : 1;
}
