// Where frames were taken, in C++: as locate.c, with the owners and exceptions of veiloc.hpp.
//
//     locate_cpp HOST PORT MAP MODEL WIDTH,HEIGHT,PARAMS... POSES FRAME.pgm...
#include <cstdio>
#include <fstream>
#include <iostream>
#include <sstream>

#include "http.h"
#include "veiloc.hpp"

static int run(int argc, char **argv) {
  if (argc < 8) {
    std::cerr << "locate_cpp HOST PORT MAP MODEL WIDTH,HEIGHT,PARAMS... POSES FRAME.pgm...\n";
    return 2;
  }
  const auto request = [&](const std::string &path, const veiloc::Bytes &body, veiloc::Bytes &reply) {
    uint8_t *data = nullptr;
    size_t length = 0;
    const int status =
        http_request(argv[1], argv[2], path.c_str(), body.empty() ? nullptr : body.data(), body.size(), &data, &length);
    reply.assign(data, data + length);
    free(data);
    return status;
  };
  const std::string map = std::string("/v1/maps/") + argv[3];

  VeilocCamera camera{};
  camera.model = argv[4];
  std::istringstream numbers(argv[5]);
  char comma = 0;
  numbers >> camera.width >> comma >> camera.height;
  while (camera.param_count < 16 && numbers >> comma >> camera.params[camera.param_count]) camera.param_count++;

  veiloc::Bytes reply;
  if (request(map + "/profile", {}, reply) != 200) throw std::runtime_error("no profile of this map");
  const auto sealer = veiloc::sealer(veiloc::profile(reply));
  auto session = veiloc::session();
  const auto burst = veiloc::burst();
  const auto alignment = veiloc::alignment();
  std::ifstream poses(argv[6]);
  for (int i = 7; i < argc; i++) {
    std::ifstream file(argv[i], std::ios::binary);
    std::string magic;
    int brightest = 0;
    VeilocFrame frame{};
    file >> magic >> frame.width >> frame.height >> brightest;
    file.get();
    veiloc::Bytes pixels(size_t(frame.width) * frame.height);
    if (magic != "P5" || !file.read(reinterpret_cast<char *>(pixels.data()), std::streamsize(pixels.size())))
      throw std::runtime_error(std::string(argv[i]) + " is not a PGM file");
    frame.bytes = pixels.data();
    frame.length = pixels.size();
    frame.format = VEILOC_PIXEL_FORMAT_GRAY;
    VeilocPose pose{};
    double seconds = 0;
    poses >> seconds;
    for (double &number : pose.position) poses >> number;
    for (double &number : pose.rotation) poses >> number;
    // An app offers every frame of its camera, and seals on another thread, when the last answer is there.
    veiloc::offer(burst, frame, &camera, VEILOC_AXES_OPEN_GL, pose, seconds);
    if (veiloc_burst_frames(burst.get()) < 3) continue;
    veiloc::SealedBurst sealed;
    try {
      sealed = veiloc::seal(burst, sealer, session);
    } catch (const veiloc::Error &error) {
      std::cout << i - 7 << " not sealed: " << error.what() << "\n";
      continue;
    }
    if (request(map + "/localize-rig", veiloc::bytes(sealed), reply) != 200) {
      std::cout << i - 7 << " not found\n";
      continue;
    }
    const auto answer = veiloc::answer(reply.data(), reply.size());
    veiloc::learn_unit(burst, answer);
    const auto newest = veiloc::camera_in_world(sealed, VEILOC_AXES_OPEN_GL);
    const auto update = veiloc::add(alignment, answer, VEILOC_AXES_OPEN_GL, newest);
    VeilocPose found{};
    veiloc::check(veiloc_answer_camera_in_map(answer.get(), VEILOC_AXES_OPEN_GL, 0, &found));
    std::printf("%d %s %.6f %.6f %.6f update %d\n", i - 7, veiloc_answer_info(answer.get()).trusted ? "trusted" : "doubtful",
                found.position[0], found.position[1], found.position[2], int(update));
  }
  // A session goes on after the app was closed.
  session = veiloc::session_from_bytes(veiloc::to_bytes(session));
  const auto info = veiloc_alignment_info(alignment.get());
  std::printf("alignment state %d used %u contradicting %u distances %d ratio %.4f\n", int(info.state), info.used,
              info.contradicting, int(info.distances), info.distance_ratio);
  const auto placed = veiloc::world_from_anchor(alignment, VEILOC_AXES_OPEN_GL, {{0, 0, 0}, {0, 0, 0, 1}});
  std::printf("anchor %.6f %.6f %.6f %.9f %.9f %.9f %.9f\n", placed.position[0], placed.position[1], placed.position[2],
              placed.rotation[0], placed.rotation[1], placed.rotation[2], placed.rotation[3]);
  return info.state == VEILOC_ALIGNMENT_STATE_ALIGNED ? 0 : 1;
}

int main(int argc, char **argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception &error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
