// Seals raw frames with given seeds through veiloc.hpp and compares the queries with those that the library made of the
// image files, as seals.c.
//
//     seals_cpp PROFILE FRAMES_FOLDER REPEAT
#include <algorithm>
#include <fstream>
#include <iostream>
#include <iterator>
#include <sstream>

#define VEILOC_SEEDED
#include "veiloc.hpp"

static veiloc::Bytes read(const std::string &path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(path + ": cannot be read");
  return {std::istreambuf_iterator<char>(file), {}};
}

// The first frame sealed with the pack: equal to the reference, or refused where the frame does not show the place.
static void packs(const std::string &folder, const VeilocFrame &frame, const VeilocCamera &camera) {
  const auto pack = veiloc::pack(read(folder + "/pack")), other = veiloc::pack(read(folder + "/pack"));
  const auto expected = read(folder + "/matched");
  VeilocOptions options{};
  options.pack = pack.get();
  const auto sealer = veiloc::sealer(veiloc::profile(other), &options);
  const auto extracted = veiloc::extract(sealer, frame, &camera);
  const uint8_t seed[32] = {};
  VeilocQuery *handle = nullptr;
  const auto status = veiloc_sealer_seal_seeded(sealer.get(), nullptr, extracted.get(), seed, &handle);
  const veiloc::Query query(handle);
  if (expected.empty() ? status != VEILOC_STATUS_NOT_THIS_PLACE : status != VEILOC_STATUS_OK || veiloc::bytes(query) != expected)
    throw std::runtime_error("the first frame differs with the pack");
}

// Nothing under a mask reaches the query (rule L13).
static void masks(const veiloc::Sealer &sealer, const std::string &folder, VeilocFrame frame, const VeilocCamera &camera) {
  const auto labels = read(folder + "/mask"), hidden = read(folder + "/hidden.rgba");
  VeilocMask mask{};
  mask.bytes = labels.data();
  mask.length = labels.size();
  mask.kind = VEILOC_MASK_KIND_ARCORE_SEMANTICS;
  mask.width = 40;
  mask.height = 30;
  mask.row_stride = 48;
  frame.bytes = hidden.data();
  frame.mask = &mask;
  const auto extracted = veiloc::extract(sealer, frame, &camera);
  const uint8_t seed[32] = {};
  VeilocQuery *handle = nullptr;
  veiloc::check(veiloc_sealer_seal_seeded(sealer.get(), nullptr, extracted.get(), seed, &handle));
  if (veiloc::bytes(veiloc::Query(handle)) != read(folder + "/masked")) throw std::runtime_error("the mask does not hide");
}

static int run(const std::string &profile_path, const std::string &folder, int repeat) {
  const auto profile = veiloc::profile(read(profile_path));
  const auto known = read(folder + "/answer");
  if (veiloc::json(veiloc::answer(known.data(), known.size())) != read(folder + "/answer.json"))
    throw std::runtime_error("the document of an answer differs");
  const auto sealer = veiloc::sealer(profile);
  std::ifstream list(folder + "/frames.txt");
  int count = 0;
  for (std::string line; std::getline(list, line); count++) {
    std::istringstream words(line);
    std::string number, model;
    VeilocCamera camera{};
    words >> number >> camera.width >> camera.height >> model;
    camera.model = model.c_str();
    while (camera.param_count < 16 && words >> camera.params[camera.param_count]) camera.param_count++;
    const auto pixels = read(folder + "/" + number + ".rgba"), expected = read(folder + "/" + number + ".query");
    VeilocFrame frame{};
    frame.bytes = pixels.data();
    frame.length = pixels.size();
    frame.format = VEILOC_PIXEL_FORMAT_RGBA;
    frame.width = camera.width;
    frame.height = camera.height;
    if (count == 0) packs(folder, frame, camera);
    if (count == 0) masks(sealer, folder, frame, camera);
    uint8_t seed[32];
    std::fill(std::begin(seed), std::end(seed), uint8_t(std::stoi(number)));
    for (int i = 0; i < (count == 0 ? repeat + 1 : 1); i++) {
      const auto extracted = veiloc::extract(sealer, frame, &camera);
      VeilocQuery *handle = nullptr;
      veiloc::check(veiloc_sealer_seal_seeded(sealer.get(), nullptr, extracted.get(), seed, &handle));
      const veiloc::Query query(handle);
      if (veiloc::bytes(query) != expected) throw std::runtime_error("frame " + number + " differs");
    }
  }
  std::cout << count << " queries equal, " << repeat << " repeated\n";
  return count > 0 ? 0 : 1;
}

int main(int argc, char **argv) {
  if (argc != 4) return 2;
  try {
    return run(argv[1], argv[2], std::stoi(argv[3]));
  } catch (const std::exception &error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
