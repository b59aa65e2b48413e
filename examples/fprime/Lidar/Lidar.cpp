#include "Lander/Lidar/Lidar.hpp"

#include <limits>

namespace Lander {

namespace {

constexpr unsigned UNIT = 0;

static_assert(LidarMode::SAFE == LIDAR_MODE_SAFE, "LidarMode is not that of lidar.h");
static_assert(LidarReason::AMBIGUOUS == LIDAR_REASON_AMBIGUOUS, "LidarReason is not that of lidar.h");
static_assert(LidarVerdict::OUT_OF_RANGE == LIDAR_VERDICT_OUT_OF_RANGE, "LidarVerdict is not that of lidar.h");

//! A code of the lidar as a constant of an FPP enumeration; `other` for a code that the enumeration lacks.
template <typename Enum>
Enum enumOf(uint64_t code, typename Enum::T other) {
    return code < Enum::NUM_CONSTANTS ? static_cast<typename Enum::T>(code) : other;
}

F64 valueOr(bool hasValue, F64 value) {
    return hasValue ? value : std::numeric_limits<F64>::quiet_NaN();
}

LidarBeam toTelemetry(const lidar_beam& beam) {
    return LidarBeam(valueOr(beam.has_range_m, beam.range_m), valueOr(beam.has_closing_speed_mps, beam.closing_speed_mps),
                     beam.range_valid, beam.speed_valid, enumOf<LidarReason>(beam.reason, LidarReason::NO_SURFACE));
}

}  // namespace

Lidar::Lidar(const char* name)
    : LidarComponentBase(name), m_host(), m_mode(LidarMode::OFF), m_shotsLost(0), m_opCode(0), m_cmdSeq(0) {
    m_host.unit = UNIT;
}

// ---------------------------------------------------------------------------------------------------- messages

void Lidar::drvReceiveIn_handler(FwIndexType, Fw::Buffer& buffer, const Drv::ByteStreamStatus& status) {
    if (status == Drv::ByteStreamStatus::OP_OK) {
        const U8* const bytes = buffer.getData();
        for (FwSizeType k = 0; k < buffer.getSize(); k++) {
            lidar_host_feed(&m_host, bytes[k]);
            for (lidar_kind kind = lidar_host_next(&m_host); kind != LIDAR_NOTHING; kind = lidar_host_next(&m_host)) {
                takeMessage(kind);
            }
        }
        tlmWrite_BadFrames(m_host.receiver.bad_frames + m_host.foreign_packets);
    }
    drvReceiveReturnOut_out(0, buffer);
}

void Lidar::takeMessage(lidar_kind kind) {
    if (kind == LIDAR_MEASUREMENT) {
        takeShot();
    } else if (kind == LIDAR_ACKNOWLEDGE) {
        takeAnswer();
    } else {
        takeMode(m_host.health.mode);
        if (m_host.health.has_temperature_c) {
            tlmWrite_Temperature(static_cast<F32>(m_host.health.temperature_c));
        }
    }
}

void Lidar::takeShot() {
    const lidar_measurement& from = m_host.shot;
    takeMode(from.shot.mode);
    LidarBeams beams(toTelemetry(lidar_beam{}));  // a beam that the packet lacks is one that did not fire
    for (FwSizeType k = 0; k < from.beam_count && k < LidarBeams::SIZE; k++) {
        beams[k] = toTelemetry(from.beams[k]);
    }
    tlmWrite_Shot(LidarShot(static_cast<U32>(from.shot.shot), from.shot.time_ns, m_mode, beams));
    if (m_host.shots_lost != m_shotsLost) {
        log_WARNING_LO_ShotsMissing(m_host.shots_lost - m_shotsLost);
        m_shotsLost = m_host.shots_lost;
    }
    tlmWrite_ShotsLost(m_shotsLost);
}

void Lidar::takeMode(uint64_t mode) {
    const LidarMode now = enumOf<LidarMode>(mode, LidarMode::FAULT);
    if (now != m_mode) {
        m_mode = now;
        log_ACTIVITY_HI_ModeChanged(now);
    }
}

// ---------------------------------------------------------------------------------------------------- commands

void Lidar::NO_OP_cmdHandler(FwOpcodeType opCode, U32 cmdSeq) {
    U8 frame[LIDAR_LONGEST_COMMAND];
    command(opCode, cmdSeq, LIDAR_COMMAND_NO_OP, frame,
            lidar_encode_no_op(frame, m_host.unit, m_host.sequence));
}

void Lidar::SET_MODE_cmdHandler(FwOpcodeType opCode, U32 cmdSeq, const LidarMode& mode) {
    U8 frame[LIDAR_LONGEST_COMMAND];
    command(opCode, cmdSeq, LIDAR_COMMAND_SET_MODE, frame,
            lidar_encode_set_mode(frame, m_host.unit, m_host.sequence, mode.e));
}

void Lidar::SET_PATTERN_cmdHandler(FwOpcodeType opCode, U32 cmdSeq, U8 pattern) {
    U8 frame[LIDAR_LONGEST_COMMAND];
    command(opCode, cmdSeq, LIDAR_COMMAND_SET_PATTERN, frame,
            lidar_encode_set_pattern(frame, m_host.unit, m_host.sequence, pattern));
}

void Lidar::SET_RATE_cmdHandler(FwOpcodeType opCode, U32 cmdSeq, F64 rate_hz) {
    U8 frame[LIDAR_LONGEST_COMMAND];
    command(opCode, cmdSeq, LIDAR_COMMAND_SET_RATE_HZ, frame,
            lidar_encode_set_rate_hz(frame, m_host.unit, m_host.sequence, rate_hz));
}

//! Send a command; its response follows with the acknowledgement.
void Lidar::command(FwOpcodeType opCode, U32 cmdSeq, U8 code, const U8* frame, size_t length) {
    const bool isPending = m_host.attempts > 0;
    if (!lidar_host_begin(&m_host, code, frame, length)) {
        cmdResponse_out(opCode, cmdSeq, isPending ? Fw::CmdResponse::BUSY : Fw::CmdResponse::VALIDATION_ERROR);
        return;
    }
    m_opCode = opCode;
    m_cmdSeq = cmdSeq;
    sendPending();
}

void Lidar::sendPending() {
    Fw::Buffer frame(m_host.pending, m_host.pending_length);
    (void)drvSendOut_out(0, frame);  // a frame that the driver did not take is repeated as a lost one is
}

void Lidar::takeAnswer() {
    if (!m_host.is_answered) {
        return;
    }
    if (m_host.is_verdict_lost) {
        log_WARNING_HI_VerdictLost();
        respond(Fw::CmdResponse::EXECUTION_ERROR);
        return;
    }
    const LidarVerdict verdict = enumOf<LidarVerdict>(m_host.answer.verdict, LidarVerdict::UNKNOWN);
    if (verdict != LidarVerdict::ACCEPTED) {
        log_WARNING_HI_CommandRejected(verdict);
    }
    respond(verdict == LidarVerdict::ACCEPTED ? Fw::CmdResponse::OK : Fw::CmdResponse::EXECUTION_ERROR);
}

void Lidar::run_handler(FwIndexType, U32) {
    const bool wasPending = m_host.attempts > 0;
    if (lidar_host_repeat(&m_host)) {
        sendPending();
    } else if (wasPending) {
        log_WARNING_HI_CommandNotAnswered();
        respond(Fw::CmdResponse::EXECUTION_ERROR);
    }
}

void Lidar::respond(Fw::CmdResponse response) {
    cmdResponse_out(m_opCode, m_cmdSeq, response);
}

}  // namespace Lander
