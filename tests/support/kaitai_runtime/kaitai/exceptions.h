/* The error of a sync word that is another one; see kaitaistream.h. */
#ifndef KAITAI_EXCEPTIONS_H
#define KAITAI_EXCEPTIONS_H

#include "kaitai/kaitaistream.h"

namespace kaitai {

template <typename Value> class validation_not_equal_error : public std::runtime_error {
public:
    validation_not_equal_error(const Value &, const Value &, kstream *, const std::string &where)
        : std::runtime_error("not the expected bytes: " + where) {}
};

}  // namespace kaitai

#endif
