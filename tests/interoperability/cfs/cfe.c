/* A processor with one application: standard input is its software bus, a message in hexadecimal per line. It prints
 *     message HEXADECIMAL, event ID TEXT, exit STATUS */
#include "cfe.h"

#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

void LIDAR_APP_Main(void);

bool CFE_ES_RunLoop(uint32 *RunStatus) { return *RunStatus == CFE_ES_RunStatus_APP_RUN; }

void CFE_ES_ExitApp(uint32 ExitStatus) { printf("exit %u\n", (unsigned)ExitStatus); }

CFE_Status_t CFE_ES_WriteToSysLog(const char *SpecStringPtr, ...) {
    puts(SpecStringPtr);
    return CFE_SUCCESS;
}

CFE_Status_t CFE_EVS_Register(const void *Filters, uint16 NumEventFilters, uint16 FilterScheme) {
    return Filters == NULL && NumEventFilters == 0 && FilterScheme == CFE_EVS_EventFilter_BINARY ? CFE_SUCCESS : -1;
}

CFE_Status_t CFE_EVS_SendEvent(uint16 EventID, uint16 EventType, const char *Spec, ...) {
    va_list arguments;
    (void)EventType;
    va_start(arguments, Spec);
    printf("event %u ", (unsigned)EventID);
    vprintf(Spec, arguments);
    printf("\n");
    va_end(arguments);
    return CFE_SUCCESS;
}

CFE_Status_t CFE_MSG_Init(CFE_MSG_Message_t *MsgPtr, CFE_SB_MsgId_t MsgId, CFE_MSG_Size_t Size) {
    memset(MsgPtr, 0, Size);
    MsgPtr->Byte[0] = (uint8)(MsgId >> 8);
    MsgPtr->Byte[1] = (uint8)MsgId;
    MsgPtr->Byte[4] = (uint8)((Size - 7) >> 8);
    MsgPtr->Byte[5] = (uint8)(Size - 7);
    return CFE_SUCCESS;
}

CFE_Status_t CFE_MSG_GetFcnCode(const CFE_MSG_Message_t *MsgPtr, CFE_MSG_FcnCode_t *FcnCode) {
    *FcnCode = ((const CFE_MSG_CommandHeader_t *)MsgPtr)->Sec[0] & 0x7F;
    return CFE_SUCCESS;
}

CFE_Status_t CFE_MSG_GetMsgId(const CFE_MSG_Message_t *MsgPtr, CFE_SB_MsgId_t *MsgId) {
    *MsgId = (CFE_SB_MsgId_t)(MsgPtr->Byte[0] << 8 | MsgPtr->Byte[1]);
    return CFE_SUCCESS;
}

CFE_Status_t CFE_MSG_GetSize(const CFE_MSG_Message_t *MsgPtr, CFE_MSG_Size_t *Size) {
    *Size = (size_t)(MsgPtr->Byte[4] << 8 | MsgPtr->Byte[5]) + 7;
    return CFE_SUCCESS;
}

CFE_Status_t CFE_SB_CreatePipe(CFE_SB_PipeId_t *PipeIdPtr, uint16 Depth, const char *PipeName) {
    *PipeIdPtr = 1;
    return Depth > 0 && PipeName != NULL ? CFE_SUCCESS : -1;
}

CFE_Status_t CFE_SB_ReceiveBuffer(CFE_SB_Buffer_t **BufPtr, CFE_SB_PipeId_t PipeId, int32 TimeOut) {
    static CFE_SB_Buffer_t buffer[16];
    uint8 *const bytes = (uint8 *)buffer;
    char line[2 * sizeof buffer + 2];
    struct pollfd bus = {.fd = STDIN_FILENO, .events = POLLIN};
    unsigned byte;
    if (poll(&bus, 1, TimeOut) <= 0)
        return CFE_SB_TIME_OUT;
    if (PipeId != 1 || fgets(line, sizeof line, stdin) == NULL)
        return CFE_SB_PIPE_RD_ERR;
    for (size_t k = 0; sscanf(line + 2 * k, "%2x", &byte) == 1; k++)
        bytes[k] = (uint8)byte;
    *BufPtr = buffer;
    return CFE_SUCCESS;
}

CFE_Status_t CFE_SB_Subscribe(CFE_SB_MsgId_t MsgId, CFE_SB_PipeId_t PipeId) {
    return MsgId != CFE_SB_INVALID_MSG_ID && PipeId == 1 ? CFE_SUCCESS : -1;
}

void CFE_SB_TimeStampMsg(CFE_MSG_Message_t *MsgPtr) { (void)MsgPtr; }

CFE_Status_t CFE_SB_TransmitMsg(const CFE_MSG_Message_t *MsgPtr, bool IsOrigination) {
    CFE_MSG_Size_t size;
    (void)IsOrigination;
    CFE_MSG_GetSize(MsgPtr, &size);
    printf("message ");
    for (size_t k = 0; k < size; k++)
        printf("%02x", ((const uint8 *)MsgPtr)[k]);
    printf("\n");
    return CFE_SUCCESS;
}

int main(void) {
    setvbuf(stdin, NULL, _IONBF, 0);
    setvbuf(stdout, NULL, _IOLBF, 0);
    LIDAR_APP_Main();
    return 0;
}
