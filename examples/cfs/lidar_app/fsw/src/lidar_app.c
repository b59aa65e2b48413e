/* A cFS application for a lidar on a serial port: a telemetry message per shot, commands, housekeeping.
 *
 * Send LIDAR_APP_SEND_HK_MID once a second: with it, a command that the lidar has not acknowledged is repeated. */
#define LIDAR_MAXIMUM_BEAMS 4
#include "lidar_host.h"

#include "lidar_app_msg.h"
#include "lidar_port.h"

#include <math.h>

#ifndef LIDAR_APP_PORT
#define LIDAR_APP_PORT "/dev/ttyUSB0"
#endif

#define LIDAR_APP_UNIT       0
#define LIDAR_APP_PIPE_DEPTH 32
#define LIDAR_APP_PERIOD_MS  10 /* how long received bytes wait at most */

#define LIDAR_APP_STARTUP_EID    1
#define LIDAR_APP_NOOP_EID       2
#define LIDAR_APP_COMMAND_EID    3
#define LIDAR_APP_ACCEPTED_EID   4
#define LIDAR_APP_REJECTED_EID   5
#define LIDAR_APP_UNANSWERED_EID 6
#define LIDAR_APP_PORT_EID       7
#define LIDAR_APP_MODE_EID       8
#define LIDAR_APP_LOST_EID       9

static struct
{
    uint32              RunStatus;
    CFE_SB_PipeId_t     Pipe;
    LIDAR_APP_ShotTlm_t ShotTlm;
    LIDAR_APP_HkTlm_t   HkTlm;
    lidar_host          Host;
} LIDAR_APP_Data;

/* ------------------------------------------------------------------------------------- messages of the lidar */

static void LIDAR_APP_SetMode(uint64_t Mode)
{
    LIDAR_APP_HkTlm_Payload_t *Hk = &LIDAR_APP_Data.HkTlm.Payload;

    if (Hk->Mode != (uint8)Mode)
    {
        Hk->Mode = (uint8)Mode;
        CFE_EVS_SendEvent(LIDAR_APP_MODE_EID, CFE_EVS_EventType_INFORMATION, "LIDAR: mode %u", (unsigned int)Mode);
    }
}

static void LIDAR_APP_PublishShot(void)
{
    const lidar_measurement     *From = &LIDAR_APP_Data.Host.shot;
    LIDAR_APP_ShotTlm_Payload_t *To   = &LIDAR_APP_Data.ShotTlm.Payload;
    const lidar_beam             None = {.reason = LIDAR_REASON_NOT_FIRED};

    LIDAR_APP_SetMode(From->shot.mode);
    To->Time_ns = From->shot.time_ns;
    To->Shot    = (uint32)From->shot.shot;
    To->Mode    = (uint8)From->shot.mode;
    for (size_t k = 0; k < LIDAR_APP_BEAMS; k++)
    {
        const lidar_beam *Beam = k < From->beam_count ? &From->beams[k] : &None;

        To->Beams[k].Range_m          = Beam->has_range_m ? Beam->range_m : NAN;
        To->Beams[k].ClosingSpeed_mps = Beam->has_closing_speed_mps ? Beam->closing_speed_mps : NAN;
        To->Beams[k].RangeValid       = Beam->range_valid;
        To->Beams[k].SpeedValid       = Beam->speed_valid;
        To->Beams[k].Reason           = (uint8)Beam->reason;
    }
    CFE_SB_TimeStampMsg(CFE_MSG_PTR(LIDAR_APP_Data.ShotTlm.TelemetryHeader));
    CFE_SB_TransmitMsg(CFE_MSG_PTR(LIDAR_APP_Data.ShotTlm.TelemetryHeader), true);
}

static void LIDAR_APP_TakeAnswer(void)
{
    const lidar_host          *Host = &LIDAR_APP_Data.Host;
    LIDAR_APP_HkTlm_Payload_t *Hk   = &LIDAR_APP_Data.HkTlm.Payload;

    if (!Host->is_answered)
    {
        return;
    }
    if (Host->is_verdict_lost)
    {
        Hk->Unanswered++;
        CFE_EVS_SendEvent(LIDAR_APP_LOST_EID, CFE_EVS_EventType_ERROR,
                          "LIDAR: verdict on command %u lost, it may have been executed",
                          (unsigned int)Host->answer.command);
        return;
    }
    Hk->LastVerdict = (uint8)Host->answer.verdict;
    if (Host->answer.verdict == LIDAR_VERDICT_ACCEPTED)
    {
        Hk->Accepted++;
        CFE_EVS_SendEvent(LIDAR_APP_ACCEPTED_EID, CFE_EVS_EventType_INFORMATION, "LIDAR: command %u accepted",
                          (unsigned int)Host->answer.command);
        return;
    }
    Hk->Rejected++;
    CFE_EVS_SendEvent(LIDAR_APP_REJECTED_EID, CFE_EVS_EventType_ERROR, "LIDAR: command %u rejected, verdict %u",
                      (unsigned int)Host->answer.command, (unsigned int)Host->answer.verdict);
}

static void LIDAR_APP_TakeMessage(lidar_kind Kind)
{
    const lidar_housekeeping *Health = &LIDAR_APP_Data.Host.health;

    if (Kind == LIDAR_MEASUREMENT)
    {
        LIDAR_APP_PublishShot();
    }
    else if (Kind == LIDAR_ACKNOWLEDGE)
    {
        LIDAR_APP_TakeAnswer();
    }
    else
    {
        LIDAR_APP_SetMode(Health->mode);
        LIDAR_APP_Data.HkTlm.Payload.Temperature_degc = Health->has_temperature_c ? (float)Health->temperature_c : NAN;
    }
}

static void LIDAR_APP_ReadPort(void)
{
    uint8 Bytes[1024];
    long  Count;

    while ((Count = lidar_port_read(Bytes, sizeof(Bytes))) > 0)
    {
        for (long k = 0; k < Count; k++)
        {
            lidar_kind Kind;

            lidar_host_feed(&LIDAR_APP_Data.Host, Bytes[k]);
            while ((Kind = lidar_host_next(&LIDAR_APP_Data.Host)) != LIDAR_NOTHING)
            {
                LIDAR_APP_TakeMessage(Kind);
            }
        }
    }
    if (Count < 0)
    {
        CFE_EVS_SendEvent(LIDAR_APP_PORT_EID, CFE_EVS_EventType_CRITICAL, "LIDAR: the port is gone");
        LIDAR_APP_Data.RunStatus = CFE_ES_RunStatus_APP_ERROR;
    }
}

/* ------------------------------------------------------------------------------------------ software bus */

static void LIDAR_APP_Refuse(const char *Why)
{
    LIDAR_APP_Data.HkTlm.Payload.CommandErrorCounter++;
    CFE_EVS_SendEvent(LIDAR_APP_COMMAND_EID, CFE_EVS_EventType_ERROR, "LIDAR: command refused: %s", Why);
}

/* Forward a command to the lidar; its answer shows in housekeeping. */
static void LIDAR_APP_Forward(uint8 Command, const uint8 *Frame, size_t Length)
{
    lidar_host *Host      = &LIDAR_APP_Data.Host;
    const bool  IsPending = Host->attempts > 0;

    if (lidar_host_begin(Host, Command, Frame, Length))
    {
        LIDAR_APP_Data.HkTlm.Payload.CommandCounter++;
        lidar_port_write(Host->pending, Host->pending_length); /* repeated, if it was not taken whole */
    }
    else
    {
        LIDAR_APP_Refuse(IsPending ? "another one is pending" : "value out of range");
    }
}

static void LIDAR_APP_ResetCounters(void)
{
    LIDAR_APP_HkTlm_Payload_t *Hk = &LIDAR_APP_Data.HkTlm.Payload;

    Hk->CommandCounter = Hk->CommandErrorCounter = 0;
    Hk->Accepted = Hk->Rejected = Hk->Unanswered = 0;
}

static size_t LIDAR_APP_LengthOf(CFE_MSG_FcnCode_t Code)
{
    switch (Code)
    {
        case LIDAR_APP_SET_MODE_CC:
        case LIDAR_APP_SET_PATTERN_CC:
            return sizeof(LIDAR_APP_CodeCmd_t);
        case LIDAR_APP_SET_RATE_CC:
            return sizeof(LIDAR_APP_RateCmd_t);
        default:
            return sizeof(LIDAR_APP_NoArgsCmd_t);
    }
}

static void LIDAR_APP_TakeCommand(const CFE_SB_Buffer_t *Buffer)
{
    const LIDAR_APP_CodeCmd_t *Code     = (const LIDAR_APP_CodeCmd_t *)Buffer;
    const LIDAR_APP_RateCmd_t *Rate     = (const LIDAR_APP_RateCmd_t *)Buffer;
    const uint8                Sequence = LIDAR_APP_Data.Host.sequence;
    CFE_MSG_FcnCode_t          Function = 0;
    size_t                     Length   = 0;
    uint8                      Frame[LIDAR_LONGEST_COMMAND];

    CFE_MSG_GetFcnCode(&Buffer->Msg, &Function);
    CFE_MSG_GetSize(&Buffer->Msg, &Length);
    if (Length != LIDAR_APP_LengthOf(Function))
    {
        LIDAR_APP_Refuse("wrong length");
        return;
    }
    switch (Function)
    {
        case LIDAR_APP_NOOP_CC:
            LIDAR_APP_Data.HkTlm.Payload.CommandCounter++;
            CFE_EVS_SendEvent(LIDAR_APP_NOOP_EID, CFE_EVS_EventType_INFORMATION, "LIDAR: no-op");
            break;
        case LIDAR_APP_RESET_COUNTERS_CC:
            LIDAR_APP_ResetCounters();
            break;
        case LIDAR_APP_SYNCHRONISE_CC:
            LIDAR_APP_Forward(LIDAR_COMMAND_NO_OP, Frame,
                              lidar_encode_no_op(Frame, LIDAR_APP_UNIT, Sequence));
            break;
        case LIDAR_APP_SET_MODE_CC:
            LIDAR_APP_Forward(LIDAR_COMMAND_SET_MODE, Frame,
                              lidar_encode_set_mode(Frame, LIDAR_APP_UNIT, Sequence, Code->Value));
            break;
        case LIDAR_APP_SET_PATTERN_CC:
            LIDAR_APP_Forward(LIDAR_COMMAND_SET_PATTERN, Frame,
                              lidar_encode_set_pattern(Frame, LIDAR_APP_UNIT, Sequence, Code->Value));
            break;
        case LIDAR_APP_SET_RATE_CC:
            LIDAR_APP_Forward(LIDAR_COMMAND_SET_RATE_HZ, Frame,
                              lidar_encode_set_rate_hz(Frame, LIDAR_APP_UNIT, Sequence, Rate->Rate_hz));
            break;
        default:
            LIDAR_APP_Refuse("unknown function code");
            break;
    }
}

static void LIDAR_APP_RepeatCommand(void)
{
    lidar_host *Host       = &LIDAR_APP_Data.Host;
    const bool  WasPending = Host->attempts > 0;

    if (lidar_host_repeat(Host))
    {
        lidar_port_write(Host->pending, Host->pending_length);
    }
    else if (WasPending)
    {
        LIDAR_APP_Data.HkTlm.Payload.Unanswered++;
        CFE_EVS_SendEvent(LIDAR_APP_UNANSWERED_EID, CFE_EVS_EventType_ERROR, "LIDAR: no acknowledgement");
    }
}

static void LIDAR_APP_PublishHousekeeping(void)
{
    const lidar_host          *Host = &LIDAR_APP_Data.Host;
    LIDAR_APP_HkTlm_Payload_t *Hk   = &LIDAR_APP_Data.HkTlm.Payload;

    Hk->Shots     = Host->shots;
    Hk->ShotsLost = Host->shots_lost;
    Hk->BadFrames = Host->receiver.bad_frames + Host->foreign_packets;
    CFE_SB_TimeStampMsg(CFE_MSG_PTR(LIDAR_APP_Data.HkTlm.TelemetryHeader));
    CFE_SB_TransmitMsg(CFE_MSG_PTR(LIDAR_APP_Data.HkTlm.TelemetryHeader), true);
}

static void LIDAR_APP_TakeBuffer(const CFE_SB_Buffer_t *Buffer)
{
    CFE_SB_MsgId_t MsgId = CFE_SB_INVALID_MSG_ID;

    CFE_MSG_GetMsgId(&Buffer->Msg, &MsgId);
    switch (CFE_SB_MsgIdToValue(MsgId))
    {
        case LIDAR_APP_CMD_MID:
            LIDAR_APP_TakeCommand(Buffer);
            break;
        case LIDAR_APP_SEND_HK_MID:
            LIDAR_APP_RepeatCommand();
            LIDAR_APP_PublishHousekeeping();
            break;
        default:
            LIDAR_APP_Refuse("unknown message");
            break;
    }
}

/* ----------------------------------------------------------------------------------------------- application */

static CFE_Status_t LIDAR_APP_Subscribe(void)
{
    CFE_Status_t Status = CFE_SB_CreatePipe(&LIDAR_APP_Data.Pipe, LIDAR_APP_PIPE_DEPTH, "LIDAR_APP_PIPE");

    if (Status == CFE_SUCCESS)
    {
        Status = CFE_SB_Subscribe(CFE_SB_ValueToMsgId(LIDAR_APP_CMD_MID), LIDAR_APP_Data.Pipe);
    }
    if (Status == CFE_SUCCESS)
    {
        Status = CFE_SB_Subscribe(CFE_SB_ValueToMsgId(LIDAR_APP_SEND_HK_MID), LIDAR_APP_Data.Pipe);
    }
    return Status;
}

static bool LIDAR_APP_Init(void)
{
    CFE_MSG_Init(CFE_MSG_PTR(LIDAR_APP_Data.HkTlm.TelemetryHeader), CFE_SB_ValueToMsgId(LIDAR_APP_HK_TLM_MID),
                 sizeof(LIDAR_APP_Data.HkTlm));
    CFE_MSG_Init(CFE_MSG_PTR(LIDAR_APP_Data.ShotTlm.TelemetryHeader), CFE_SB_ValueToMsgId(LIDAR_APP_SHOT_TLM_MID),
                 sizeof(LIDAR_APP_Data.ShotTlm));
    LIDAR_APP_Data.HkTlm.Payload.Temperature_degc = NAN;
    LIDAR_APP_Data.Host.unit                      = LIDAR_APP_UNIT;
    if (CFE_EVS_Register(NULL, 0, CFE_EVS_EventFilter_BINARY) != CFE_SUCCESS || LIDAR_APP_Subscribe() != CFE_SUCCESS)
    {
        CFE_ES_WriteToSysLog("LIDAR: no events or no software bus\n");
        return false;
    }
    if (!lidar_port_open(LIDAR_APP_PORT))
    {
        CFE_EVS_SendEvent(LIDAR_APP_PORT_EID, CFE_EVS_EventType_CRITICAL, "LIDAR: cannot open %s", LIDAR_APP_PORT);
        return false;
    }
    CFE_EVS_SendEvent(LIDAR_APP_STARTUP_EID, CFE_EVS_EventType_INFORMATION, "LIDAR: reads %s", LIDAR_APP_PORT);
    return true;
}

void LIDAR_APP_Main(void)
{
    CFE_SB_Buffer_t *Buffer;
    CFE_Status_t     Status;

    LIDAR_APP_Data.RunStatus = LIDAR_APP_Init() ? CFE_ES_RunStatus_APP_RUN : CFE_ES_RunStatus_APP_ERROR;
    while (CFE_ES_RunLoop(&LIDAR_APP_Data.RunStatus) == true)
    {
        Status = CFE_SB_ReceiveBuffer(&Buffer, LIDAR_APP_Data.Pipe, LIDAR_APP_PERIOD_MS);
        if (Status == CFE_SUCCESS)
        {
            LIDAR_APP_TakeBuffer(Buffer);
        }
        else if (Status != CFE_SB_TIME_OUT)
        {
            LIDAR_APP_Data.RunStatus = CFE_ES_RunStatus_APP_ERROR;
        }
        LIDAR_APP_ReadPort();
    }
    CFE_ES_ExitApp(LIDAR_APP_Data.RunStatus);
}
