/* Messages of the lidar on the software bus. Message identifiers: free ones of your mission. */
#ifndef LIDAR_APP_MSG_H
#define LIDAR_APP_MSG_H

#include "cfe.h"

#define LIDAR_APP_CMD_MID      0x18C2
#define LIDAR_APP_SEND_HK_MID  0x18C3
#define LIDAR_APP_HK_TLM_MID   0x08C2
#define LIDAR_APP_SHOT_TLM_MID 0x08C3

#define LIDAR_APP_NOOP_CC           0
#define LIDAR_APP_RESET_COUNTERS_CC 1
#define LIDAR_APP_SYNCHRONISE_CC    2 /* the lidar counts commands on from here */
#define LIDAR_APP_SET_MODE_CC       3
#define LIDAR_APP_SET_PATTERN_CC    4
#define LIDAR_APP_SET_RATE_CC       5

#define LIDAR_APP_BEAMS 4

typedef struct
{
    CFE_MSG_CommandHeader_t CommandHeader;
} LIDAR_APP_NoArgsCmd_t;

typedef struct
{
    CFE_MSG_CommandHeader_t CommandHeader;
    uint8                   Value; /* mode, as LIDAR_MODE_... in lidar.h, or number of the pattern */
    uint8                   Spare[7];
} LIDAR_APP_CodeCmd_t;

typedef struct
{
    CFE_MSG_CommandHeader_t CommandHeader;
    double                  Rate_hz;
} LIDAR_APP_RateCmd_t;

typedef struct
{
    double Range_m;          /* NaN where there is none */
    double ClosingSpeed_mps; /* NaN where there is none */
    uint8  RangeValid;
    uint8  SpeedValid;
    uint8  Reason; /* LIDAR_REASON_... */
    uint8  Spare[5];
} LIDAR_APP_Beam_t;

typedef struct
{
    int64            Time_ns; /* of validity, from the epoch of the lidar's clock */
    uint32           Shot;
    uint8            Mode; /* LIDAR_MODE_... */
    uint8            Spare[3];
    LIDAR_APP_Beam_t Beams[LIDAR_APP_BEAMS];
} LIDAR_APP_ShotTlm_Payload_t;

typedef struct
{
    CFE_MSG_TelemetryHeader_t   TelemetryHeader;
    LIDAR_APP_ShotTlm_Payload_t Payload;
} LIDAR_APP_ShotTlm_t;

typedef struct
{
    uint8  CommandCounter;
    uint8  CommandErrorCounter; /* unknown, of a wrong length or value, or while another one was pending */
    uint8  Mode;                /* LIDAR_MODE_..., of the newest packet */
    uint8  LastVerdict;         /* LIDAR_VERDICT_..., of the newest answer */
    uint32 Shots;
    uint32 ShotsLost;
    uint32 BadFrames; /* without a valid packet, or with one of another interface */
    uint32 Accepted;  /* commands, by the lidar */
    uint32 Rejected;
    uint32 Unanswered; /* not acknowledged, or the verdict was lost: may have been executed */
    float  Temperature_degc; /* NaN before the first housekeeping packet */
} LIDAR_APP_HkTlm_Payload_t;

typedef struct
{
    CFE_MSG_TelemetryHeader_t TelemetryHeader;
    LIDAR_APP_HkTlm_Payload_t Payload;
} LIDAR_APP_HkTlm_t;

#endif
