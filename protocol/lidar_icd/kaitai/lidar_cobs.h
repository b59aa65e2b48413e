/* Consistent overhead byte stuffing, for the code that Kaitai Struct's compiler writes from lidar.ksy. */
#ifndef LIDAR_COBS_H
#define LIDAR_COBS_H

#include <cstddef>
#include <string>

/* Process `lidar_cobs`. */
class lidar_cobs_t {
public:
    /* Removes the stuffing of a frame without its delimiter; empty if there is no valid stuffing. */
    std::string decode(const std::string &data) const {
        std::string decoded;
        std::size_t position = 0;
        while (position < data.size()) {
            const std::size_t code = static_cast<unsigned char>(data[position]);
            if (code == 0 || code > data.size() - position) {
                return std::string();
            }
            decoded.append(data, position + 1, code - 1);
            position += code;
            if (code < 255 && position < data.size()) {
                decoded.push_back('\0');
            }
        }
        return decoded;
    }
};

#endif
