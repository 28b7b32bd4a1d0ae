/*
 * Where frames were taken, in C: seals bursts of three frames, sends them with the app's own HTTP, and brings content that is
 * placed in the map into the world of the AR framework.
 *
 *     locate HOST PORT MAP MODEL WIDTH,HEIGHT,PARAMS... POSES FRAME.pgm...
 *
 * POSES has a line for each frame: when the camera took it, seconds, and its pose by ARKit or ARCore: x y z qx qy qz qw.
 */
#include "http.h"
#include "veiloc.h"

static int failed(const char *what) {
  fprintf(stderr, "%s: %s\n", what, veiloc_last_error());
  return 1;
}

/* A gray image of the PGM format, as `convert photo.jpg photo.pgm` or `ffmpeg` writes it. */
static uint8_t *read_pgm(const char *path, uint32_t *width, uint32_t *height) {
  FILE *file = fopen(path, "rb");
  uint8_t *pixels = NULL;
  if (!file) return NULL;
  if (fscanf(file, "P5 %u %u 255", width, height) == 2 && fgetc(file) != EOF && *width < 20000 && *height < 20000) {
    size_t length = (size_t)*width * *height;
    pixels = (uint8_t *)malloc(length);
    if (pixels && fread(pixels, 1, length, file) != length) {
      free(pixels);
      pixels = NULL;
    }
  }
  fclose(file);
  return pixels;
}

int main(int argc, char **argv) {
  VeilocProfile *profile = NULL;
  VeilocSealer *sealer = NULL;
  VeilocSession *session = NULL;
  VeilocBurst *burst = NULL;
  VeilocAlignment *alignment = NULL;
  VeilocCamera camera = {0};
  VeilocAlignmentInfo info;
  VeilocPose anchor = {{0, 0, 0}, {0, 0, 0, 1}}, placed;
  char path[256];
  uint8_t *reply;
  size_t length;
  FILE *poses;
  uint32_t misses = 0;
  if (argc < 8) {
    fprintf(stderr, "locate HOST PORT MAP MODEL WIDTH,HEIGHT,PARAMS... POSES FRAME.pgm...\n");
    return 2;
  }

  /* The camera, in a model and order of COLMAP's. For ARKit and ARCore: veiloc_camera_pinhole. */
  camera.model = argv[4];
  {
    char *rest = argv[5];
    camera.width = (uint32_t)strtoul(rest, &rest, 10);
    camera.height = (uint32_t)strtoul(*rest ? rest + 1 : rest, &rest, 10);
    while (*rest == ',' && camera.param_count < 16) camera.params[camera.param_count++] = strtod(rest + 1, &rest);
  }

  /* Once for each map. An app keeps the bytes, and asks with their ETag whether they are current. */
  snprintf(path, sizeof path, "/v1/maps/%s/profile", argv[3]);
  if (http_request(argv[1], argv[2], path, NULL, 0, &reply, &length) != 200) {
    fprintf(stderr, "no profile of the map %s\n", argv[3]);
    free(reply);
    return 1;
  }
  if (veiloc_profile_new(reply, length, &profile) != VEILOC_STATUS_OK) return failed("the profile");
  free(reply);
  if (veiloc_sealer_new(profile, NULL, &sealer) != VEILOC_STATUS_OK) return failed("the sealer");
  veiloc_profile_free(profile);
  if (veiloc_session_new(NULL, &session) != VEILOC_STATUS_OK) return failed("the session");
  if (veiloc_burst_new(NULL, &burst) != VEILOC_STATUS_OK) return failed("the burst");
  if (veiloc_alignment_new(0, &alignment) != VEILOC_STATUS_OK) return failed("the alignment");
  poses = fopen(argv[6], "r");
  if (!poses) return failed(argv[6]);

  snprintf(path, sizeof path, "/v1/maps/%s/localize-rig", argv[3]);
  for (int i = 7; i < argc; i++) {
    VeilocFrame frame = {0};
    VeilocSealedBurst *sealed = NULL;
    VeilocSealedBurstInfo burst_info;
    VeilocBytes bytes;
    VeilocPose pose, found;
    VeilocStatus status;
    VeilocAnswer *answer = NULL;
    uint8_t *pixels = read_pgm(argv[i], &frame.width, &frame.height);
    double seconds;
    int http;
    if (!pixels || fscanf(poses, "%lf %lf %lf %lf %lf %lf %lf %lf", &seconds, &pose.position[0], &pose.position[1],
                          &pose.position[2], &pose.rotation[0], &pose.rotation[1], &pose.rotation[2],
                          &pose.rotation[3]) != 8) {
      fprintf(stderr, "%s: no frame, or no pose\n", argv[i]);
      return 1;
    }
    frame.bytes = pixels;
    frame.length = (size_t)frame.width * frame.height;
    frame.format = VEILOC_PIXEL_FORMAT_GRAY;

    /* An app offers every frame of its camera, and seals on another thread, when the last answer is there. */
    status = veiloc_burst_offer(burst, &frame, &camera, VEILOC_AXES_OPEN_GL, &pose, seconds);
    free(pixels); /* A copy is kept until it is sealed. */
    if (status != VEILOC_STATUS_OK) return failed("a frame");
    if (veiloc_burst_frames(burst) < 3) continue;
    status = veiloc_burst_seal(burst, sealer, session, NULL, &sealed);
    if (status != VEILOC_STATUS_OK) {
      /* Nothing was sent: the next burst costs nothing. */
      printf("%d not sealed: %s\n", i - 7, veiloc_last_error());
      continue;
    }
    burst_info = veiloc_sealed_burst_info(sealed);
    if (veiloc_sealed_burst_bytes(sealed, &bytes) != VEILOC_STATUS_OK) return failed("the burst");
    /* The answer is about this pose: that of the newest frame of the burst. */
    if (veiloc_sealed_burst_camera_in_world(sealed, VEILOC_AXES_OPEN_GL, &pose) != VEILOC_STATUS_OK) return failed("its pose");
    veiloc_sealed_burst_free(sealed);

    http = http_request(argv[1], argv[2], path, bytes.data, bytes.length, &reply, &length);
    veiloc_bytes_free(bytes);
    if (http == 200) {
      VeilocAnswerInfo numbers;
      VeilocUpdate update;
      if (veiloc_answer_new(reply, length, &answer) != VEILOC_STATUS_OK) return failed("the answer");
      numbers = veiloc_answer_info(answer);
      /* Until the unit of the map is known, a burst is one frame. */
      if (veiloc_burst_learn_unit(burst, answer) != VEILOC_STATUS_OK) return failed("the unit");
      misses = 0;
      if (veiloc_answer_camera_in_map(answer, VEILOC_AXES_OPEN_GL, 0, &found) == VEILOC_STATUS_OK &&
          veiloc_alignment_add(alignment, answer, VEILOC_AXES_OPEN_GL, &pose, &update) == VEILOC_STATUS_OK) {
        printf("%d %s %.6f %.6f %.6f update %d\n", i - 7, numbers.trusted ? "trusted" : "doubtful", found.position[0],
               found.position[1], found.position[2], (int)update);
      }
    } else {
      misses += http == 422;
      printf("%d status %d\n", i - 7, http);
    }
    printf("  %s\n", veiloc_advice_text(veiloc_advice(&burst_info.newest, answer, 0, misses)));
    veiloc_answer_free(answer);
    free(reply);
  }
  fclose(poses);

  info = veiloc_alignment_info(alignment);
  printf("alignment state %d used %u contradicting %u distances %d ratio %.4f\n", (int)info.state, info.used,
         info.contradicting, (int)info.distances, info.distance_ratio);
  /* Content at the origin of the map, in the world of the AR framework. */
  if (veiloc_alignment_world_from_anchor(alignment, VEILOC_AXES_OPEN_GL, &anchor, &placed) == VEILOC_STATUS_OK) {
    printf("anchor %.6f %.6f %.6f %.9f %.9f %.9f %.9f\n", placed.position[0], placed.position[1], placed.position[2],
           placed.rotation[0], placed.rotation[1], placed.rotation[2], placed.rotation[3]);
  }
  veiloc_alignment_free(alignment);
  veiloc_burst_free(burst);
  veiloc_session_free(session);
  veiloc_sealer_free(sealer);
  return info.state == VEILOC_ALIGNMENT_STATE_ALIGNED ? 0 : 1;
}
