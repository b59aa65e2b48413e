/* What the code that fpp-to-cpp generates for examples/fprime uses of F Prime's C++: types that serialise as F Prime's do
 * (big-endian), and a component base. Ports are called directly, so that a topology defines what each output port does. */
#ifndef FRAMEWORK_HPP
#define FRAMEWORK_HPP

#include <cassert>
#include <cinttypes>
#include <cstring>
#include <iterator>
#include <mutex>
#include <type_traits>
#include <vector>

#define FW_ASSERT(condition, ...) assert(condition)
#define FW_CMD_CHECK_RESIDUAL 1
#define FW_DIRECT_PORT_CALLS 1
#define FW_ENABLE_TEXT_LOGGING 0

using U8 = std::uint8_t;
using U16 = std::uint16_t;
using U32 = std::uint32_t;
using U64 = std::uint64_t;
using I8 = std::int8_t;
using I16 = std::int16_t;
using I32 = std::int32_t;
using I64 = std::int64_t;
using F32 = float;
using F64 = double;
using FwAssertArgType = I32;
using FwChanIdType = U32;
using FwEnumStoreType = I32;
using FwEventIdType = U32;
using FwIndexType = I16;
using FwOpcodeType = U32;
using FwSizeType = U64;

enum class TimeBase { TB_NONE };

namespace Fw {

enum SerializeStatus { FW_SERIALIZE_OK, FW_DESERIALIZE_FORMAT_ERROR, FW_DESERIALIZE_BUFFER_EMPTY };
enum class Endianness { BIG };
struct StringBase {};

class SerialBufferBase;

struct Serializable {
    virtual ~Serializable() = default;
    virtual SerializeStatus serializeTo(SerialBufferBase&, Endianness = Endianness::BIG) const = 0;
    virtual SerializeStatus deserializeFrom(SerialBufferBase&, Endianness = Endianness::BIG) = 0;
};

class SerialBufferBase {
  public:
    SerializeStatus serializeFrom(const Serializable& value, Endianness = Endianness::BIG) {
        return value.serializeTo(*this);
    }

    template <typename Number, typename = std::enable_if_t<std::is_arithmetic<Number>::value>>
    SerializeStatus serializeFrom(Number value, Endianness = Endianness::BIG) {
        U8 native[sizeof value];
        std::memcpy(native, &value, sizeof value);
        m_bytes.insert(m_bytes.end(), std::reverse_iterator<U8*>(native + sizeof value), std::reverse_iterator<U8*>(native));
        return FW_SERIALIZE_OK;
    }

    SerializeStatus deserializeTo(Serializable& value, Endianness = Endianness::BIG) {
        return value.deserializeFrom(*this);
    }

    template <typename Number, typename = std::enable_if_t<std::is_arithmetic<Number>::value>>
    SerializeStatus deserializeTo(Number& value, Endianness = Endianness::BIG) {
        U8 native[sizeof value];
        if (getDeserializeSizeLeft() < sizeof value) {
            return FW_DESERIALIZE_BUFFER_EMPTY;
        }
        for (std::size_t k = 0; k < sizeof value; k++) {
            native[sizeof value - 1 - k] = m_bytes[m_next++];
        }
        std::memcpy(&value, native, sizeof value);
        return FW_SERIALIZE_OK;
    }

    void resetDeser() { m_next = 0; }
    FwSizeType getDeserializeSizeLeft() const { return m_bytes.size() - m_next; }

    std::vector<U8> m_bytes;

  private:
    std::size_t m_next = 0;
};

struct CmdArgBuffer : SerialBufferBase {};
struct LogBuffer : SerialBufferBase {};
struct TlmBuffer : SerialBufferBase {};

struct Time {
    Time() = default;
    Time(TimeBase, U32, U32) {}
    bool operator==(const Time&) const { return true; }
};
const Time ZERO_TIME;

class Buffer {
  public:
    Buffer(U8* data, FwSizeType size) : m_data(data), m_size(size) {}
    U8* getData() const { return m_data; }
    FwSizeType getSize() const { return m_size; }

  private:
    U8* m_data;
    FwSizeType m_size;
};

struct PassiveComponentBase {
    explicit PassiveComponentBase(const char*) {}
    void init(FwEnumStoreType) {}
    U32 getIdBase() const { return 0; }
};

}  // namespace Fw

namespace Os {

struct Mutex : std::mutex {
    void unLock() { unlock(); }
};

}  // namespace Os

// Generated of framework.fpp. Its ports are not needed: they are called directly.
#include "ByteStreamStatusEnumAc.hpp"
#include "CmdResponseEnumAc.hpp"
#include "LogSeverityEnumAc.hpp"

#endif
