#ifndef Lander_Lidar_HPP
#define Lander_Lidar_HPP

#define LIDAR_MAXIMUM_BEAMS 4
#include "lidar_host.h"

#include "Lander/Lidar/LidarComponentAc.hpp"

namespace Lander {

class Lidar : public LidarComponentBase {
  public:
    explicit Lidar(const char* name);

  private:
    void drvReceiveIn_handler(FwIndexType port, Fw::Buffer& buffer, const Drv::ByteStreamStatus& status) override;
    void run_handler(FwIndexType port, U32 context) override;
    void NO_OP_cmdHandler(FwOpcodeType opCode, U32 cmdSeq) override;
    void SET_MODE_cmdHandler(FwOpcodeType opCode, U32 cmdSeq, const LidarMode& mode) override;
    void SET_PATTERN_cmdHandler(FwOpcodeType opCode, U32 cmdSeq, U8 pattern) override;
    void SET_RATE_cmdHandler(FwOpcodeType opCode, U32 cmdSeq, F64 rate_hz) override;

    void takeMessage(lidar_kind kind);
    void takeShot();
    void takeAnswer();
    void takeMode(uint64_t mode);
    void command(FwOpcodeType opCode, U32 cmdSeq, U8 code, const U8* frame, size_t length);
    void sendPending();
    void respond(Fw::CmdResponse response);

    lidar_host m_host;
    LidarMode m_mode;
    U32 m_shotsLost;
    FwOpcodeType m_opCode;  //!< of the command that waits for the acknowledgement
    U32 m_cmdSeq;
};

}  // namespace Lander

#endif
