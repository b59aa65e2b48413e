module Lander {

  @ Modes of the lidar, as LIDAR_MODE_... in lidar.h
  enum LidarMode : U8 { OFF, STANDBY, SELF_TEST, ACQUIRE, TRACK, FAULT, SAFE }

  @ Why a value is missing, as LIDAR_REASON_... in lidar.h
  enum LidarReason : U8 { VALID, NOT_FIRED, NO_SURFACE, BELOW_THRESHOLD, BEYOND_RANGE, INSIDE_GROUND, AMBIGUOUS }

  @ What the lidar did with a command, as LIDAR_VERDICT_... in lidar.h
  enum LidarVerdict : U8 { ACCEPTED, UNKNOWN, MALFORMED, BAD_SEQUENCE, OUT_OF_STATE, OUT_OF_RANGE }

  struct LidarBeam {
    range_m: F64 @< NaN where there is none
    closing_speed_mps: F64 @< NaN where there is none
    range_valid: bool
    speed_valid: bool
    reason: LidarReason
  }

  array LidarBeams = [4] LidarBeam

  struct LidarShot {
    shot: U32
    time_ns: I64 @< Time of validity, from the epoch of the lidar's clock
    mode: LidarMode
    beams: LidarBeams
  }

  @ A landing lidar on a byte stream, such as Drv.LinuxUartDriver
  passive component Lidar {

    @ Bytes from the driver
    guarded input port drvReceiveIn: Drv.ByteStreamData

    @ Return of their buffers
    output port drvReceiveReturnOut: Fw.BufferSend

    @ Commands to the driver
    output port drvSendOut: Drv.ByteStreamSend

    @ Once a second: repeats a command that was not acknowledged
    guarded input port run: Svc.Sched

    @ Synchronise with the lidar: it accepts any sequence number, and counts on from there
    guarded command NO_OP

    guarded command SET_MODE(mode: LidarMode)

    @ Number of the pattern in the scanner's list; 255: as the scanner switches by itself
    guarded command SET_PATTERN(pattern: U8)

    guarded command SET_RATE(rate_hz: F64)

    telemetry Shot: LidarShot

    telemetry Temperature: F32 format "{} degC"

    telemetry ShotsLost: U32 update on change

    @ Frames without a valid packet, and packets of another interface
    telemetry BadFrames: U32 update on change

    event ModeChanged(mode: LidarMode) severity activity high format "The lidar is in mode {}"

    event ShotsMissing(count: U32) severity warning low format "{} shots are missing" throttle 10

    event CommandRejected(verdict: LidarVerdict) severity warning high format "The lidar rejected a command: {}"

    event CommandNotAnswered severity warning high format "The lidar does not acknowledge"

    @ The acknowledgement of an earlier attempt was lost, and the repeat is out of turn
    event VerdictLost severity warning high format "The verdict is lost: the lidar may have executed the command"

    command recv port cmdIn

    command reg port cmdRegOut

    command resp port cmdResponseOut

    event port logOut

    text event port logTextOut

    telemetry port tlmOut

    time get port timeCaller

  }

}
