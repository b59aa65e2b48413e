# What examples/fprime uses of F Prime's model: names, types and ports as in F Prime 4.
# A topology with direct port calls needs no more of them than their generated component base class.

type FwAssertArgType = I32
type FwChanIdType = U32
type FwDpIdType = U32
type FwDpPriorityType = U32
type FwEnumStoreType = I32
type FwEventIdType = U32
type FwIndexType = I16
type FwOpcodeType = U32
type FwPacketDescriptorType = U16
type FwPrmIdType = U32
type FwQueueSizeType = U64
type FwSignedSizeType = I64
type FwSizeStoreType = U16
type FwSizeType = U64
type FwTaskIdType = I32
type FwTaskPriorityType = U8
type FwTimeBaseStoreType = U16
type FwTimeContextStoreType = U8
type FwTlmPacketizeIdType = U16
type FwTraceIdType = U32

module Fw {

  type Buffer
  type CmdArgBuffer
  type LogBuffer
  type TextLogString
  type Time
  type TlmBuffer

  enum CmdResponse : U8 { OK, INVALID_OPCODE, VALIDATION_ERROR, FORMAT_ERROR, EXECUTION_ERROR, BUSY }

  enum LogSeverity {
    FATAL = 1, WARNING_HI = 2, WARNING_LO = 3, COMMAND = 4, ACTIVITY_HI = 5, ACTIVITY_LO = 6, DIAGNOSTIC = 7
  }

  port BufferGet($size: FwSizeType) -> Buffer
  port BufferSend(ref fwBuffer: Buffer)
  port Cmd(opCode: FwOpcodeType, cmdSeq: U32, ref args: CmdArgBuffer)
  port CmdReg(opCode: FwOpcodeType)
  port CmdResponse(opCode: FwOpcodeType, cmdSeq: U32, response: CmdResponse)
  port Log($id: FwEventIdType, ref timeTag: Time, $severity: LogSeverity, ref args: LogBuffer)
  port LogText($id: FwEventIdType, ref timeTag: Time, $severity: LogSeverity, ref $text: TextLogString)
  port Time(ref $time: Time)
  port Tlm($id: FwChanIdType, ref timeTag: Time, ref val: TlmBuffer)

}

module Svc {

  port Sched(context: U32)

  passive component BufferManager {
    guarded input port bufferGetCallee: Fw.BufferGet
    guarded input port bufferSendIn: Fw.BufferSend
  }

  passive component RateGroup {
    output port RateGroupMemberOut: [10] Sched
  }

}

module Drv {

  enum ByteStreamStatus : U8 { OP_OK, SEND_RETRY, RECV_NO_DATA, OTHER_ERROR }

  port ByteStreamData(ref buffer: Fw.Buffer, status: ByteStreamStatus)
  port ByteStreamReady()
  port ByteStreamSend(ref sendBuffer: Fw.Buffer) -> ByteStreamStatus

  passive component LinuxUartDriver {
    output port ready: ByteStreamReady
    output port $recv: ByteStreamData
    guarded input port $send: ByteStreamSend
    guarded input port recvReturnIn: Fw.BufferSend
    output port allocate: Fw.BufferGet
    output port deallocate: Fw.BufferSend
  }

}

instance bufferManager: Svc.BufferManager base id 0x100
instance rateGroup1Hz: Svc.RateGroup base id 0x200

topology Framework {
  instance bufferManager
  instance rateGroup1Hz
}
