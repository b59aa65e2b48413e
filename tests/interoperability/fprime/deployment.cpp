/* The component on a serial port: deployment PORT.
 *
 * A topology of direct port calls, which prints a line per call of an output port, with serialised values in hexadecimal:
 *     tlm ID VALUE, event ID ARGUMENTS, response OPCODE SEQUENCE RESPONSE
 * Standard input has a line per call of an input port, beside the bytes of the serial port:
 *     command OPCODE SEQUENCE [ARGUMENTS], run
 * The end of either of them ends it. */
#include "Lander/Lidar/Lidar.hpp"

#include <fcntl.h>
#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <string>

namespace {

int uart = -1;
Lander::Lidar lidar("lidar");

void printLine(const char* kind, U32 id, const std::vector<U8>& bytes) {
    std::printf("%s %" PRIu32 " ", kind, id);
    for (U8 byte : bytes) {
        std::printf("%02x", byte);
    }
    std::printf("\n");
}

}  // namespace

namespace Lander {

// The connections. Of command registration, time and text events this topology needs none.
bool LidarComponentBase::isConnected_cmdRegOut_OutputPort(FwIndexType) const { return false; }
bool LidarComponentBase::isConnected_cmdResponseOut_OutputPort(FwIndexType) const { return true; }
bool LidarComponentBase::isConnected_logOut_OutputPort(FwIndexType) const { return true; }
bool LidarComponentBase::isConnected_timeCaller_OutputPort(FwIndexType) const { return false; }
bool LidarComponentBase::isConnected_tlmOut_OutputPort(FwIndexType) const { return true; }
void LidarComponentBase::cmdRegOut_out(FwIndexType, FwOpcodeType) const {}
void LidarComponentBase::timeCaller_out(FwIndexType, Fw::Time&) const {}

void LidarComponentBase::cmdResponseOut_out(FwIndexType, FwOpcodeType opCode, U32 cmdSeq,
                                            const Fw::CmdResponse& response) const {
    std::printf("response %" PRIu32 " %" PRIu32 " %d\n", opCode, cmdSeq, response.e);
}

void LidarComponentBase::logOut_out(FwIndexType, FwEventIdType id, Fw::Time&, const Fw::LogSeverity&,
                                    Fw::LogBuffer& arguments) const {
    printLine("event", id, arguments.m_bytes);
}

void LidarComponentBase::tlmOut_out(FwIndexType, FwChanIdType id, Fw::Time&, Fw::TlmBuffer& value) const {
    printLine("tlm", id, value.m_bytes);
}

void LidarComponentBase::drvReceiveReturnOut_out(FwIndexType, Fw::Buffer&) const {}

Drv::ByteStreamStatus LidarComponentBase::drvSendOut_out(FwIndexType, Fw::Buffer& frame) const {
    const ssize_t written = ::write(uart, frame.getData(), frame.getSize());
    return written == static_cast<ssize_t>(frame.getSize()) ? Drv::ByteStreamStatus::OP_OK
                                                            : Drv::ByteStreamStatus::OTHER_ERROR;
}

}  // namespace Lander

namespace {

bool openUart(const char* path) {
    termios settings;
    uart = ::open(path, O_RDWR | O_NOCTTY);
    if (uart < 0 || tcgetattr(uart, &settings) != 0) {
        return false;
    }
    cfmakeraw(&settings);
    return tcsetattr(uart, TCSANOW, &settings) == 0;
}

bool receive() {
    static U8 bytes[256];
    const ssize_t count = ::read(uart, bytes, sizeof bytes);
    if (count <= 0) {
        return false;
    }
    Fw::Buffer buffer(bytes, static_cast<FwSizeType>(count));
    lidar.drvReceiveIn_handlerBase(0, buffer, Drv::ByteStreamStatus::OP_OK);
    return true;
}

bool takeLine() {
    char line[256], arguments[200] = "";
    U32 opCode, cmdSeq;
    if (std::fgets(line, sizeof line, stdin) == nullptr) {
        return false;
    }
    if (std::sscanf(line, "command %" SCNu32 " %" SCNu32 " %199s", &opCode, &cmdSeq, arguments) >= 2) {
        Fw::CmdArgBuffer buffer;
        for (std::size_t k = 0; arguments[k] != '\0'; k += 2) {
            buffer.serializeFrom(static_cast<U8>(std::stoi(std::string(arguments + k, 2), nullptr, 16)));
        }
        lidar.cmdIn_handlerBase(0, opCode, cmdSeq, buffer);
    } else {
        lidar.run_handlerBase(0, 0);
    }
    return true;
}

}  // namespace

int main(int count, char** arguments) {
    if (count != 2 || !openUart(arguments[1])) {
        std::perror("deployment PORT");
        return 1;
    }
    std::setvbuf(stdin, nullptr, _IONBF, 0);
    std::setvbuf(stdout, nullptr, _IOLBF, 0);
    lidar.init(0);
    for (bool isOpen = true; isOpen;) {
        pollfd inputs[] = {{uart, POLLIN, 0}, {STDIN_FILENO, POLLIN, 0}};
        ::poll(inputs, 2, -1);
        isOpen = (inputs[0].revents == 0 || receive()) && (inputs[1].revents == 0 || takeLine());
    }
    return 0;
}
