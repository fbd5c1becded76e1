#!/bin/sh
# Builds the fake RTDE server of Universal Robots' own client library, which crates/vservo-ur/tests/makers_server.rs runs our client against.
#
#     ur_fake_rtde.sh SOURCES PROGRAM        SOURCES: a copy of github.com/UniversalRobots/Universal_Robots_Client_Library
#
# The server is the maker's, unchanged; our own is its main alone, which takes the port as argument: the maker's has 30004 on all addresses.
set -eu
[ $# = 2 ] || { sed -n '2,6s/^# \{0,1\}//p' "$0"; exit 2; }
sources=$1
program=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cat >"$work/main.cpp" <<'CPP'
#include "fake_rtde_server.h"
#include <cstdlib>

int main(int argc, char** argv)
{
  urcl::RTDEServer server(argc > 1 ? std::atoi(argv[1]) : 30004);
  while (true)
  {
    std::this_thread::sleep_for(std::chrono::seconds(1));
  }
}
CPP
set -- "$work/main.cpp" "$sources/tests/fake_rtde_server.cpp" "$sources/src/log.cpp" "$sources/src/default_log_handler.cpp" \
    "$sources/src/helpers.cpp" "$sources/src/ur/version_information.cpp" "$sources/src/comm/tcp_server.cpp"
for file in control_package_pause control_package_setup_inputs control_package_setup_outputs control_package_start data_package \
    get_urcontrol_version request_protocol_version rtde_package rtde_parser text_message; do
    set -- "$@" "$sources/src/rtde/$file.cpp"
done
# Its buffers are sent from where a variable says that nobody has set before: zero, as its author takes it to be (GCC 12, Clang 16 and later).
"${CXX:-g++}" -std=c++17 -O1 -ftrivial-auto-var-init=zero -pthread -I"$sources/include" -I"$sources/tests" -I"$sources/3rdparty" "$@" -o "$program"
