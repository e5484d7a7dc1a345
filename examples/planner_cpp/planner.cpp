// Goes straight on and brakes for who stands ahead: examples/planner_exec.py in C++.
#include <algorithm>
#include <cmath>

#include "replan_planner.hpp"

using replan::json;

namespace {

constexpr double STEP_S = 0.1, BESIDE_M = 2.0, BEFORE_M = 8.0, GENTLE_MPS2 = 0.5;
constexpr int STEPS = 51;

json plan(const json& frame) {
  const json& ego = frame.at("ego");
  const double x0 = ego.at("x"), y0 = ego.at("y"), yaw = ego.at("yaw"), v0 = ego.at("v"), t0 = frame.at("t");
  const double cx = std::cos(yaw), cy = std::sin(yaw);
  const auto xs = replan::column(frame.at("agents").at("x")), ys = replan::column(frame.at("agents").at("y"));
  double brake = 0.0;
  for (std::size_t i = 0; i < xs.size(); ++i) {
    const double dx = xs[i] - x0, dy = ys[i] - y0;
    const double ahead = dx * cx + dy * cy, beside = dy * cx - dx * cy;
    if (ahead > 0.0 && std::abs(beside) < BESIDE_M)
      brake = std::max(brake, v0 * v0 / (2.0 * std::max(ahead - BEFORE_M, 0.1)));
  }
  brake = brake > GENTLE_MPS2 ? std::min(brake, 8.0) : 0.0;
  std::vector<double> t, x, y, heading, v, a, kappa;
  for (int i = 0; i < STEPS; ++i) {
    const double after = i * STEP_S, moving = brake > 0.0 ? std::min(after, v0 / brake) : after;
    const double s = v0 * moving - 0.5 * brake * moving * moving;
    t.push_back(t0 + after);
    x.push_back(x0 + s * cx);
    y.push_back(y0 + s * cy);
    heading.push_back(yaw);
    v.push_back(v0 - brake * moving);
    a.push_back(moving == after ? -brake : 0.0);
    kappa.push_back(0.0);
  }
  return {{"trajectory", {{"t", t}, {"x", x}, {"y", y}, {"yaw", heading}, {"v", v}, {"a", a}, {"kappa", kappa}}}};
}

}  // namespace

int main() {
  return replan::serve([](const json&) { return plan; });
}
