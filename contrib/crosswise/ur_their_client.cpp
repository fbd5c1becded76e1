// The fourth cell: the RTDE client of Universal Robots' own library before its own fake server, in one process. Nothing of ours is on the wire, so that this tells what the other three
// cells may hold against us: states at their rate, and a speed slider that is read and told back.
//
//     PROGRAM PORT

#include "fake_rtde_server.h"

#include "ur_client_library/comm/pipeline.h"
#include "ur_client_library/rtde/rtde_client.h"

#include <cmath>
#include <cstdio>
#include <cstdlib>

namespace {

[[noreturn]] void fail(const char* what) {
  std::fprintf(stderr, "%s\n", what);
  std::exit(1);
}

}  // namespace

int main(int argc, char** argv) {
  const int port = argc > 1 ? std::atoi(argv[1]) : 30004;
  urcl::RTDEServer server(port);
  urcl::comm::INotifier notifier;
  urcl::rtde_interface::RTDEClient client("127.0.0.1", notifier, {"timestamp", "actual_q", "target_speed_fraction"},
                                          {"speed_slider_mask", "speed_slider_fraction"}, 500.0, false, port);
  if (!client.init(10)) fail("they do not agree on version and recipes");
  if (!client.start(false)) fail("the server does not start to send");
  std::unique_ptr<urcl::rtde_interface::DataPackage> package =
      std::make_unique<urcl::rtde_interface::DataPackage>(client.getOutputRecipe());
  double first = -1.0, time = 0.0, last = 0.0, slider = -1.0;
  int states = 0;
  while (first < 0.0 || time - first < 2.0) {
    if (!client.getDataPackageBlocking(package)) fail("states stop");
    if (!package->getData("timestamp", time)) fail("a state has no time");
    if (first < 0.0) first = time;
    if (states > 0 && time <= last) fail("time does not go on");
    last = time;
    states++;
  }
  // It sleeps for 2 ms between two; a busy machine makes that longer.
  if (states < 330) fail("fewer than a third of the states");
  for (double wanted : {0.4, 1.0, 0.125}) {
    if (!client.getWriter().sendSpeedSlider(wanted)) fail("the client does not write");
    for (int tries = 0; slider != wanted; tries++) {
      if (tries > 1000) fail("the server does not read what its client writes");
      if (!client.getDataPackageBlocking(package)) fail("states stop");
      package->getData("target_speed_fraction", slider);
    }
  }
  std::printf("states %d in 2 s\ntheir client and their server agree\n", states);
  std::fflush(stdout);
  std::_Exit(0);  // the server's threads have no end of their own
}
