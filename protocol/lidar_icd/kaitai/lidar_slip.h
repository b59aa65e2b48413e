/* Framing of serial line IP (RFC 1055), for the code that Kaitai Struct's compiler writes from lidar.ksy. */
#ifndef LIDAR_SLIP_H
#define LIDAR_SLIP_H

#include <cstddef>
#include <string>

/* Process `lidar_slip`. */
class lidar_slip_t {
public:
    /* Removes the stuffing of a frame without its delimiter; empty if an escape sequence is invalid. */
    std::string decode(const std::string &data) const {
        std::string decoded;
        for (std::size_t k = 0; k < data.size(); ++k) {
            if (data[k] != '\xdb') {
                decoded.push_back(data[k]);
                continue;
            }
            const char code = ++k < data.size() ? data[k] : '\0';
            if (code != '\xdc' && code != '\xdd') {
                return std::string();
            }
            decoded.push_back(code == '\xdc' ? '\xc0' : '\xdb');
        }
        return decoded;
    }
};

#endif
