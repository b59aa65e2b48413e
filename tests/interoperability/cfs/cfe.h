/* What examples/cfs uses of the core Flight Executive: names, signatures and the default message headers as cFE has them. */
#ifndef CFE_H
#define CFE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef uint8_t  uint8;
typedef uint16_t uint16;
typedef int32_t  int32;
typedef uint32_t uint32;
typedef int64_t  int64;

typedef int32  CFE_Status_t;
typedef uint16 CFE_MSG_FcnCode_t;
typedef size_t CFE_MSG_Size_t;
typedef uint16 CFE_SB_MsgId_Atom_t;
typedef uint16 CFE_SB_MsgId_t;
typedef uint32 CFE_SB_PipeId_t;

#define CFE_SUCCESS           ((CFE_Status_t)0)
#define CFE_SB_TIME_OUT       ((CFE_Status_t)0xca000001)
#define CFE_SB_PIPE_RD_ERR    ((CFE_Status_t)0xca000005)
#define CFE_SB_INVALID_MSG_ID ((CFE_SB_MsgId_t)-1)

enum { CFE_ES_RunStatus_UNDEFINED, CFE_ES_RunStatus_APP_RUN, CFE_ES_RunStatus_APP_EXIT, CFE_ES_RunStatus_APP_ERROR };
enum { CFE_EVS_EventFilter_BINARY };
enum {
    CFE_EVS_EventType_DEBUG = 1,
    CFE_EVS_EventType_INFORMATION,
    CFE_EVS_EventType_ERROR,
    CFE_EVS_EventType_CRITICAL
};

/* CCSDS primary header, then function code and checksum, or six bytes of time. */
typedef union { uint8 Byte[6]; } CFE_MSG_Message_t;
typedef struct { CFE_MSG_Message_t Msg; uint8 Sec[2]; } CFE_MSG_CommandHeader_t;
typedef struct { CFE_MSG_Message_t Msg; uint8 Sec[6]; uint8 Spare[4]; } CFE_MSG_TelemetryHeader_t;
typedef union { CFE_MSG_Message_t Msg; long long LongInt; long double LongDouble; } CFE_SB_Buffer_t;

#define CFE_MSG_PTR(shdr) (&((shdr).Msg))

static inline CFE_SB_MsgId_t CFE_SB_ValueToMsgId(CFE_SB_MsgId_Atom_t MsgIdValue) { return MsgIdValue; }
static inline CFE_SB_MsgId_Atom_t CFE_SB_MsgIdToValue(CFE_SB_MsgId_t MsgId) { return MsgId; }

bool CFE_ES_RunLoop(uint32 *RunStatus);
void CFE_ES_ExitApp(uint32 ExitStatus);
CFE_Status_t CFE_ES_WriteToSysLog(const char *SpecStringPtr, ...);
CFE_Status_t CFE_EVS_Register(const void *Filters, uint16 NumEventFilters, uint16 FilterScheme);
CFE_Status_t CFE_EVS_SendEvent(uint16 EventID, uint16 EventType, const char *Spec, ...);
CFE_Status_t CFE_MSG_Init(CFE_MSG_Message_t *MsgPtr, CFE_SB_MsgId_t MsgId, CFE_MSG_Size_t Size);
CFE_Status_t CFE_MSG_GetFcnCode(const CFE_MSG_Message_t *MsgPtr, CFE_MSG_FcnCode_t *FcnCode);
CFE_Status_t CFE_MSG_GetMsgId(const CFE_MSG_Message_t *MsgPtr, CFE_SB_MsgId_t *MsgId);
CFE_Status_t CFE_MSG_GetSize(const CFE_MSG_Message_t *MsgPtr, CFE_MSG_Size_t *Size);
CFE_Status_t CFE_SB_CreatePipe(CFE_SB_PipeId_t *PipeIdPtr, uint16 Depth, const char *PipeName);
CFE_Status_t CFE_SB_ReceiveBuffer(CFE_SB_Buffer_t **BufPtr, CFE_SB_PipeId_t PipeId, int32 TimeOut);
CFE_Status_t CFE_SB_Subscribe(CFE_SB_MsgId_t MsgId, CFE_SB_PipeId_t PipeId);
void CFE_SB_TimeStampMsg(CFE_MSG_Message_t *MsgPtr);
CFE_Status_t CFE_SB_TransmitMsg(const CFE_MSG_Message_t *MsgPtr, bool IsOrigination);

#endif
