/* A drive for vservo in C11 or C++11: the services between control and the program that moves a robot.
 *
 *   drive/command (1 kHz) -> vservo_drive_wait, vservo_drive_receive
 *   drive/state           <- vservo_drive_send
 *   drive/text            <- vservo_drive_send_joint_names, vservo_drive_send_properties, vservo_drive_send_robot_text
 *   the guardian's stop   -> vservo_drive_is_stopped_by_guardian
 *
 * The records, flags and codes stand in vservo.h, which `vservo layouts --lang c > vservo.h` makes. examples/cpp_drive is a whole drive; docs/drives.md says what
 * is asked of one, and what each function promises.
 *
 * A handle belongs to the thread that opened it. No function prints, installs a handler of signals, or throws. */
#ifndef VSERVO_DRIVE_H
#define VSERVO_DRIVE_H

#include "vservo.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Joins one instance of vservo. */
typedef struct vservo_drive vservo_drive;

/* What functions that return int32_t return beside 0 and 1. vservo_drive_last_error() says it in words. */
enum {
    VSERVO_DRIVE_ERROR_ARGUMENT = -1,  /* a pointer that is NULL or not aligned, a text or a count that cannot be; nothing was done */
    VSERVO_DRIVE_ERROR_VALUE = -2,     /* a number that is not finite, or not one of its kind; nothing was sent */
    VSERVO_DRIVE_ERROR_TRANSPORT = -3, /* shared memory or the transport failed */
    VSERVO_DRIVE_ERROR_THREAD = -4,    /* not the thread that opened the handle; nothing was done */
    VSERVO_DRIVE_ERROR_INTERNAL = -5   /* a defect of this library, now and for this handle from now on: brake, and end */
};

/* Why the last function that failed in this thread did, UTF-8; "" before the first. Valid until the next one fails there. */
const char *vservo_drive_last_error(void);

/* Use vservo_drive_open: it says which records the header that you compile with has. Others than the library's are refused. */
vservo_drive *vservo_drive_open_with(const char *instance, const char *command_type, const char *state_type, const char *text_type);

/* Joins the instance of this name, or with NULL that of VSERVO_INSTANCE, else `default`. Control need not run yet. From then on the drive counts as present, and START
 * follows: be ready to hold the robot. NULL when it cannot be joined. */
static inline vservo_drive *vservo_drive_open(const char *instance) {
    return vservo_drive_open_with(instance, VSERVO_DRIVE_COMMAND_TYPE, VSERVO_DRIVE_STATE_TYPE, VSERVO_DRIVE_TEXT_TYPE);
}

/* Leaves, and frees the handle, which must not be used afterwards. 0, or an error with which the handle stays. */
int32_t vservo_drive_close(vservo_drive *drive);

/* Path of the run file in effect (TOML), there once a run has begun. Valid as long as the handle; NULL for a handle that is NULL. */
const char *vservo_drive_config_path(const vservo_drive *drive);

/* Waits until a command is there, 1, or for so long, 0. A signal ends the wait early. Zero or less only looks. */
int32_t vservo_drive_wait(vservo_drive *drive, int64_t longest_ns);

/* The next command, oldest first: 1; without one 0, and `command` is as it was. Take all that wait and obey the newest: START, CLEAR and LAST stand in any of them. With
 * START the page of the guardian's stop is mapped anew. */
int32_t vservo_drive_receive(vservo_drive *drive, vservo_DriveCommand *command);

/* 1 when a drive of so many joints may obey the command: its number of joints, a mode that there is, finite numbers. Else 0: brake. */
int32_t vservo_drive_is_valid_command(const vservo_DriveCommand *command, uint32_t joints);

/* Sends a state, and wakes control: 0. `sequence` is counted here, whatever stands there. Refused (ERROR_VALUE) are no joints, more than VSERVO_MAX_JOINTS, and numbers
 * in use that are not finite. */
int32_t vservo_drive_send(vservo_drive *drive, const vservo_DriveState *state);

/* Tells the joints' names, UTF-8, in the order of the drive's: with each START, before the state with INITIAL. `signs` (1 or -1) and `zero_offsets` (rad or m) are against the
 * joints of those names in the maker's description; NULL where they are the same. 0 when it was sent, or nobody listens. */
int32_t vservo_drive_send_joint_names(vservo_drive *drive, const char *const *names, uint32_t joints, const double *signs,
                                      const double *zero_offsets);

/* Tells what the drive is, with each START, before the state with INITIAL: the time from one state to the next, and after how long without a command it stops the arm;
 * 0 where that is not told; by how much the arm is behind its commands, below 0 where that is not told. `effort_rates` (N m/s or N/s, of so many joints) says how quickly torques may rise, in mode torque; NULL where that is not told. Control refuses a
 * drive that cannot miss two commands. 0 when it was sent, or nobody listens. */
int32_t vservo_drive_send_properties(vservo_drive *drive, int64_t period_ns, int64_t watchdog_ns, int64_t lag_ns, const double *effort_rates,
                                     uint32_t joints);

/* Tells in the maker's words what the robot is, before the state that shows it; "" when that is over. What is no UTF-8 is replaced, what is longer than 511 bytes
 * cut. */
int32_t vservo_drive_send_robot_text(vservo_drive *drive, uint32_t robot_state, uint32_t robot_code, const char *words);

/* 1 while the guardian's stop stands: brake by your own means, and hold, whatever is commanded. Look in each cycle; it is two loads from memory. */
int32_t vservo_drive_is_stopped_by_guardian(vservo_drive *drive);

/* Leaves the reason of the drive's end for the summary of the run (drive.txt), before an exit code other than 0. `instance` as in vservo_drive_open; no handle is
 * needed. 0 when the reason is there. */
int32_t vservo_drive_leave_reason(const char *instance, const char *reason);

/* CLOCK_MONOTONIC, ns: the clock of all stamps. */
int64_t vservo_drive_now_ns(void);

/* Sleeps until then, also through signals; returns at once when it has passed. */
void vservo_drive_sleep_until_ns(int64_t deadline_ns);

#ifdef __cplusplus
}
#endif

#endif
