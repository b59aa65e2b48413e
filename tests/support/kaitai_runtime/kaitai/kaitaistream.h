/* What compiled code of Kaitai Struct calls in the stream of its library for C++, for the tests alone.
 *
 * Not the library: written from its documented interface, because no package archive that the tests use has it. */
#ifndef KAITAI_STREAM_H
#define KAITAI_STREAM_H

#define KAITAI_STRUCT_VERSION 11000L

#include <cstdint>
#include <cstring>
#include <ios>
#include <stdexcept>
#include <string>

namespace kaitai {

class kstream {
public:
    explicit kstream(const std::string &data) : m_data(data), m_pos(0), m_bit(0) {}

    bool is_eof() const { return m_pos >= m_data.size(); }
    void seek(uint64_t pos) {
        m_pos = static_cast<std::size_t>(pos);
        m_bit = 0;
    }
    uint64_t pos() const { return m_pos + (m_bit > 0 ? 1 : 0); }
    uint64_t size() const { return m_data.size(); }

    int8_t read_s1() { return static_cast<int8_t>(big(1)); }
    int16_t read_s2be() { return static_cast<int16_t>(big(2)); }
    int32_t read_s4be() { return static_cast<int32_t>(big(4)); }
    int64_t read_s8be() { return static_cast<int64_t>(big(8)); }
    int16_t read_s2le() { return static_cast<int16_t>(little(2)); }
    int32_t read_s4le() { return static_cast<int32_t>(little(4)); }
    int64_t read_s8le() { return static_cast<int64_t>(little(8)); }
    uint8_t read_u1() { return static_cast<uint8_t>(big(1)); }
    uint16_t read_u2be() { return static_cast<uint16_t>(big(2)); }
    uint32_t read_u4be() { return static_cast<uint32_t>(big(4)); }
    uint64_t read_u8be() { return big(8); }
    uint16_t read_u2le() { return static_cast<uint16_t>(little(2)); }
    uint32_t read_u4le() { return static_cast<uint32_t>(little(4)); }
    uint64_t read_u8le() { return little(8); }
    float read_f4be() { return real<float>(static_cast<uint32_t>(big(4))); }
    double read_f8be() { return real<double>(big(8)); }
    float read_f4le() { return real<float>(static_cast<uint32_t>(little(4))); }
    double read_f8le() { return real<double>(little(8)); }

    void align_to_byte() { seek(pos()); }
    uint64_t read_bits_int_be(int n) {
        uint64_t value = 0;
        while (n-- > 0) {
            value = value << 1 | (byte_of_bit() >> (7 - m_bit) & 1u);
            next_bit();
        }
        return value;
    }
    uint64_t read_bits_int_le(int n) {
        uint64_t value = 0;
        for (int k = 0; k < n; ++k) {
            value |= static_cast<uint64_t>(byte_of_bit() >> m_bit & 1u) << k;
            next_bit();
        }
        return value;
    }

    std::string read_bytes(std::streamsize length) {
        align_to_byte();
        if (length < 0 || static_cast<uint64_t>(length) > m_data.size() - m_pos) {
            throw std::runtime_error("end of stream");
        }
        const std::string bytes = m_data.substr(m_pos, static_cast<std::size_t>(length));
        m_pos += bytes.size();
        return bytes;
    }
    std::string read_bytes_full() { return read_bytes(static_cast<std::streamsize>(m_data.size() - m_pos)); }
    /* The terminator is consumed and not returned; the end of the stream may stand for it. */
    std::string read_bytes_term(char term, bool, bool, bool) {
        const std::size_t end = m_data.find(term, m_pos);
        const std::string bytes = m_data.substr(m_pos, end == std::string::npos ? end : end - m_pos);
        m_pos = end == std::string::npos ? m_data.size() : end + 1;
        return bytes;
    }

private:
    std::string m_data;
    std::size_t m_pos;
    int m_bit;

    uint64_t big(int length) {
        uint64_t value = 0;
        for (const char byte : read_bytes(length)) {
            value = value << 8 | static_cast<unsigned char>(byte);
        }
        return value;
    }
    uint64_t little(int length) {
        uint64_t value = 0;
        int shift = 0;
        for (const char byte : read_bytes(length)) {
            value |= static_cast<uint64_t>(static_cast<unsigned char>(byte)) << shift;
            shift += 8;
        }
        return value;
    }
    template <typename Real, typename Bits> static Real real(Bits bits) {
        Real value;
        std::memcpy(&value, &bits, sizeof value);
        return value;
    }
    unsigned byte_of_bit() const {
        if (is_eof()) {
            throw std::runtime_error("end of stream");
        }
        return static_cast<unsigned char>(m_data[m_pos]);
    }
    void next_bit() {
        m_bit = (m_bit + 1) % 8;
        m_pos += m_bit == 0 ? 1 : 0;
    }
};

}  // namespace kaitai

#endif
