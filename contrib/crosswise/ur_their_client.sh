#!/bin/sh
# Builds the RTDE client of Universal Robots' own client library together with its own fake RTDE server: a control for the tests of our ends against theirs.
#
#     ur_their_client.sh SOURCES PROGRAM        SOURCES: a copy of github.com/UniversalRobots/Universal_Robots_Client_Library
set -eu
[ $# = 2 ] || { sed -n '2,4s/^# \{0,1\}//p' "$0"; exit 2; }
own=$(cd "$(dirname "$0")" && pwd)
sources=$1
program=$2
set -- "$own/ur_their_client.cpp" "$sources/tests/fake_rtde_server.cpp" "$sources/src/log.cpp" "$sources/src/default_log_handler.cpp" \
    "$sources/src/helpers.cpp" "$sources/src/ur/version_information.cpp" "$sources/src/comm/tcp_server.cpp" "$sources/src/comm/tcp_socket.cpp" "$sources"/src/rtde/*.cpp
# As for the server alone (ur_fake_rtde.sh).
"${CXX:-g++}" -std=c++17 -O1 -ftrivial-auto-var-init=zero -pthread -I"$sources/include" -I"$sources/tests" -I"$sources/3rdparty" "$@" -o "$program"
