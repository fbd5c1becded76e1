// vpServo of ViSP as an entrant of `vservo benchmark`: eye-in-hand, image-based on points or position-based on translation and theta u.
//
//   entrant current|mean|pbvs [LAMBDA | LAMBDA_0 LAMBDA_INF SLOPE [PRODUCT]]
//
// One number is a constant gain (1/s), three are those of vpAdaptiveGain: at an error of zero, at a large one, and the slope at zero. A fourth is the largest product of
// gain and delay: where LAMBDA_0 times the delay of the cell (latency and half a frame) is more, all gains are that much less. README.md says how to build it.
// SPDX-License-Identifier: MIT OR Apache-2.0

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <unistd.h>
#include <vector>
#include <visp3/core/vpConfig.h>
#include <visp3/core/vpPoint.h>
#include <visp3/vision/vpPose.h>
#include <visp3/visual_features/vpFeaturePoint.h>
#include <visp3/visual_features/vpFeatureThetaU.h>
#include <visp3/visual_features/vpFeatureTranslation.h>
#include <visp3/vs/vpAdaptiveGain.h>
#include <visp3/vs/vpServo.h>

using nlohmann::json;

namespace {

constexpr double MAX_SPEED = 100; // m/s, rad/s: ten times what arms can do, a tenth of what the benchmark takes for a mistake

vpHomogeneousMatrix pose_of(const json &pose) {
  const auto p = pose["position_m"], q = pose["rotation_xyzw"];
  return {vpTranslationVector(p[0], p[1], p[2]), vpQuaternionVector(q[0], q[1], q[2], q[3])};
}

// The pose of points with the normalized coordinates that were measured; false where it is not found.
bool pose_from(const json &features, const std::vector<vpPoint> &model, vpHomogeneousMatrix &cMo) {
  vpPose pose;
  for (const auto &f : features) {
    const size_t id = f["id"];
    if (id >= model.size()) continue;
    vpPoint p = model[id];
    p.set_x(f["x"]);
    p.set_y(f["y"]);
    pose.addPoint(p);
  }
  if (pose.npt < 4) return false;
  // as the examples of ViSP do: the better of two linear solutions, refined by virtual visual servoing
  vpHomogeneousMatrix dementhon, lagrange;
  double best = INFINITY;
  for (auto method : {vpPose::DEMENTHON, vpPose::LAGRANGE}) {
    vpHomogeneousMatrix found;
    try {
      if (!pose.computePose(method, found)) continue;
    } catch (const std::exception &) {
      continue;
    }
    const double residual = pose.computeResidual(found);
    if (found[2][3] > 0 && residual < best) best = residual, cMo = found;
  }
  return std::isfinite(best) && pose.computePose(vpPose::VIRTUAL_VS, cMo);
}

class Entrant {
public:
  Entrant(const std::string &law, const std::vector<double> &gains, const json &begin) : pbvs(law == "pbvs") {
    for (const auto &p : begin["target"]["points"]) {
      const size_t id = p["id"];
      if (model.size() <= id) model.resize(id + 1);
      const auto x = p["position_m"];
      model[id] = vpPoint(x[0], x[1], x[2]);
    }
    const json &goal = begin["goal"];
    is_ready = true;
    if (!goal["pose"].is_null()) cdMo = pose_of(goal["pose"]);
    else is_ready = pose_from(goal["features"], model, cdMo);
    task.setServo(vpServo::EYEINHAND_CAMERA);
    task.setInteractionMatrixType(law == "mean" ? vpServo::MEAN : vpServo::CURRENT, vpServo::PSEUDO_INVERSE);
    const json &camera = begin["camera"];
    const double delay_s = camera["latency_s"].get<double>() + 0.5 / camera["rate_hz"].get<double>();
    const double share = gains.size() == 4 ? std::min(1.0, gains[3] / (gains[0] * delay_s)) : 1.0;
    if (gains.size() == 1) task.setLambda(gains[0]);
    else task.setLambda(gains[0] * share, gains[1] * share, gains[2] * share);
    if (pbvs) {
      task.addFeature(t);
      task.addFeature(tu);
      return;
    }
    const size_t count = goal["features"].size();
    s.resize(count);
    s_D.resize(count);
    for (size_t i = 0; i < count; ++i) {
      const json &f = goal["features"][i];
      const size_t id = f["id"];
      ids.push_back(id);
      s_D[i].buildFrom(f["x"], f["y"], depth(cdMo, id));
      task.addFeature(s[i], s_D[i]);
    }
  }

  json answer(const json &see) {
    vpHomogeneousMatrix cMo;
    if (!is_ready || !see["found"] || !pose_from(see["features"], model, cMo)) return nullptr;
    if (pbvs) {
      const vpHomogeneousMatrix cdMc = cdMo * cMo.inverse();
      t.buildFrom(cdMc);
      tu.buildFrom(cdMc);
    } else {
      // a point that is hidden is where the pose has it
      for (size_t i = 0; i < ids.size(); ++i) {
        vpPoint p = model[ids[i]];
        p.track(cMo);
        s[i].buildFrom(p.get_x(), p.get_y(), p.get_Z());
        for (const auto &f : see["features"])
          if (f["id"] == ids[i]) s[i].buildFrom(f["x"], f["y"], p.get_Z());
      }
    }
    vpColVector v = task.computeControlLaw();
    // Near a singularity, such as half a turn of the mean matrix, a pseudo-inverse asks for kilometres a second: the direction is kept, and the arm's limits do the rest.
    const double most = v.infinityNorm();
    if (most > MAX_SPEED) v *= MAX_SPEED / most;
    return {{"twist", std::vector<double>(v.data, v.data + 6)}};
  }

private:
  double depth(const vpHomogeneousMatrix &M, size_t id) const {
    vpPoint p = model[id];
    p.changeFrame(M);
    return p.get_Z();
  }

  bool pbvs, is_ready;
  std::vector<vpPoint> model;
  std::vector<size_t> ids;
  vpHomogeneousMatrix cdMo;
  vpServo task;
  std::vector<vpFeaturePoint> s, s_D;
  vpFeatureTranslation t{vpFeatureTranslation::cdMc};
  vpFeatureThetaU tu{vpFeatureThetaU::cdRc};
};

json card(const std::string &law, const std::vector<double> &gains) {
  const std::string about = law == "pbvs" ? "position-based, t and theta u of cdMc"
                                          : "image-based, points, matrix " + law + ", depths from vpPose";
  const std::string version = std::to_string(VISP_VERSION_MAJOR) + "." + std::to_string(VISP_VERSION_MINOR);
  json settings;
  if (gains.size() == 1) settings["lambda_1_s"] = gains[0];
  else settings["vpAdaptiveGain"] = {gains[0], gains[1], gains[2]};
  if (gains.size() == 4) settings["largest_gain_times_delay"] = gains[3];
  return {{"about", "vpServo of ViSP " + version + ": " + about}, {"settings", settings}};
}

} // namespace

int main(int argc, char **argv) {
  const std::string law = argc > 1 ? argv[1] : "";
  std::vector<double> gains;
  for (int i = 2; i < argc; ++i) gains.push_back(std::stod(argv[i]));
  if (gains.empty()) gains = {0.5};
  if ((law != "current" && law != "mean" && law != "pbvs") || gains.size() == 2 || gains.size() > 4) {
    std::cerr << "usage: entrant current|mean|pbvs [LAMBDA | LAMBDA_0 LAMBDA_INF SLOPE [PRODUCT]]\n";
    return 2;
  }
  // Answers go to what was stdout; what ViSP prints goes to stderr.
  FILE *answers = fdopen(dup(1), "w");
  dup2(2, 1);
  std::unique_ptr<Entrant> entrant;
  std::string line;
  while (std::getline(std::cin, line)) {
    const json message = json::parse(line);
    json answer;
    if (message["vservo"] == "begin") {
      entrant = std::make_unique<Entrant>(law, gains, message);
      answer = card(law, gains);
    } else if (message["vservo"] == "see") {
      answer = entrant->answer(message);
    } else {
      break;
    }
    std::fprintf(answers, "%s\n", answer.dump().c_str());
    std::fflush(answers);
  }
}
