// A robot that the maker's mock server plays: it takes what a client asks for, answers by script, and moves as it is commanded.
//
//     PROGRAM ADDRESS [--version N] [--pattern] [--paced] [--wait-ms N] [--answer NAME=STATUS]... [--end STATUS@COMMANDS] [--state-first] [--close COMMANDS]
//
//   --version N          it speaks another version: refuses the client
//   --pattern            every number of its states is another (while no motion runs)
//   --paced              states come every millisecond; else the next waits for the command that answers the last, for --wait-ms (2000)
//   --answer NAME=STATUS the first request of this name is refused (move, load, collision, stiffness, recovery)
//   --end STATUS@N       the robot ends the motion by itself after so many commands, once: 8 by a reflex, 9 by the user stop, which is released after 0.3 s
//   --state-first        what ended a motion is in the states 20 ms before the reply; else 20 ms behind it
//   --close N            the connection is closed after so many commands
//
// What comes is told on standard output, a line each, numbers as their bits in hexadecimal.

#include "franka_mock_robot.h"

#include <future>

#include <arpa/inet.h>
#include <dlfcn.h>

namespace {

in_addr own_address;

Script read(int argc, char** argv) {
  Script script;
  for (int i = 2; i < argc; i++) {
    std::string name = argv[i];
    if (name == "--pattern" || name == "--paced" || name == "--state-first") {
      (name == "--pattern" ? script.pattern : name == "--paced" ? script.paced : script.state_first) = true;
      continue;
    }
    std::string value = i + 1 < argc ? argv[++i] : "";
    if (name == "--version") {
      script.version = std::stoul(value);
    } else if (name == "--wait-ms") {
      script.wait = std::chrono::milliseconds(std::stoul(value));
    } else if (name == "--answer") {
      size_t at = value.find('=');
      script.answers[value.substr(0, at)] = std::stoul(value.substr(at + 1));
    } else if (name == "--end") {
      size_t at = value.find('@');
      script.end_status = std::stoul(value.substr(0, at));
      script.end_after = std::stoul(value.substr(at + 1));
    } else if (name == "--close") {
      script.close_after = std::stoul(value);
    } else {
      std::fprintf(stderr, "unknown: %s\n", name.c_str());
      std::exit(2);
    }
  }
  return script;
}

}  // namespace

// The server binds 127.0.0.1, of which a machine has one; here the last three numbers are the test's own.
extern "C" int bind(int fd, const sockaddr* address, socklen_t size) {
  sockaddr_storage other{};
  std::memcpy(&other, address, size);
  if (other.ss_family == AF_INET) {
    reinterpret_cast<sockaddr_in*>(&other)->sin_addr = own_address;
    int type = 0;
    socklen_t length = sizeof(type);
    getsockopt(fd, SOL_SOCKET, SO_TYPE, &type, &length);
    states_socket = type == SOCK_DGRAM ? fd : states_socket;
  }
  static auto next = reinterpret_cast<int (*)(int, const sockaddr*, socklen_t)>(dlsym(RTLD_NEXT, "bind"));
  return next(fd, reinterpret_cast<sockaddr*>(&other), size);
}

int main(int argc, char** argv) {
  if (argc < 2 || inet_pton(AF_INET, argv[1], &own_address) != 1 || ntohl(own_address.s_addr) >> 24 != 127) {
    std::fprintf(stderr, "a loopback address is needed\n");
    return 2;
  }
  Script script = read(argc, argv);
  {
    RobotMockServer server([&script](const wire::Connect::Request& request) {
      using Status = wire::Connect::Status;
      if (request.udp_port != 0) {  // zero: the server tries what it will be answered
        std::printf("connect %u\n", request.version);
        std::fflush(stdout);
      }
      if (!script.version) {
        return wire::Connect::Response(Status::kSuccess);
      }
      // The maker's own reply has always the maker's own version.
      return __builtin_bit_cast(wire::Connect::Response, (std::array<uint8_t, 3>{static_cast<uint8_t>(Status::kIncompatibleLibraryVersion),
                                                                                 static_cast<uint8_t>(*script.version), 0}));
    });
    if (script.close_after) {
      server.ignoreUdpBuffer();
    }
    std::printf("listening\n");
    std::fflush(stdout);
    std::promise<void> over;
    std::optional<Robot> robot;
    // A client is there when the server takes this.
    server.doForever([&] {
      if (!robot) {
        robot.emplace(server, script);
      }
      bool goes_on = robot->turn();
      if (!goes_on) {
        over.set_value();
      }
      return goes_on;
    });
    server.spinOnce();
    over.get_future().wait();
  }
  bool failed = testing::UnitTest::GetInstance()->ad_hoc_test_result().Failed();
  std::printf("%s\n", failed ? "the maker's server complains" : "the maker's server is content");
  return failed ? 1 : 0;
}
