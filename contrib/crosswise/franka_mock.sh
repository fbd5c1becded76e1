#!/bin/sh
# Builds a robot around the mock server of Franka's own client library, which crates/vservo-franka/tests/makers_server.rs runs our client and driver against.
#
#     franka_mock.sh SOURCES PROGRAM        SOURCES: a copy of github.com/frankarobotics/libfranka with its submodule common, which PROGRAM reads its robot model from
#
# Server, messages and limits are the maker's, unchanged; our own is what the robot does (franka_mock.cpp). Needs Poco (libpoco-dev), gtest (libgtest-dev) and
# Eigen (libeigen3-dev).
set -eu
[ $# = 2 ] || { sed -n '2,7s/^# \{0,1\}//p' "$0"; exit 2; }
own=$(cd "$(dirname "$0")" && pwd)
sources=$(cd "$1" && pwd) # absolute: the server finds its robot model beside the file that it was compiled from
# The address at which it listens is in the maker's file; our main stands before the system's bind, so that it has to be linked by name (-rdynamic).
"${CXX:-g++}" -std=c++17 -O1 -pthread -rdynamic -Wno-deprecated-declarations -I"$sources/include" -I"$sources/common/include" -I"$sources/test" \
    $(pkg-config --cflags eigen3 2>/dev/null || echo -I/usr/include/eigen3) \
    "$own/franka_mock.cpp" "$sources/test/mock_server.cpp" "$sources/src/rate_limiting.cpp" "$sources/src/control_tools.cpp" "$sources/src/exception.cpp" \
    -o "$2" -lPocoNet -lPocoFoundation -lgtest -ldl
