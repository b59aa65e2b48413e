/* Lets user-mode Linux 6.1 run on processors whose extended state is larger than it knows (AMX): the system takes back
 * that state whole or not at all, so the part that the kernel has is laid over the process's own. Preloaded by `machine`. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

static _Alignas(64) char state[1 << 16];

long ptrace(enum __ptrace_request request, ...)
{
    static long (*next)(enum __ptrace_request, ...);
    va_list arguments;
    va_start(arguments, request);
    pid_t process = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);
    if (!next)
        *(void **)&next = dlsym(RTLD_NEXT, "ptrace");
    long done = next(request, process, address, data);
    if (done == 0 || request != PTRACE_SETREGSET || address != (void *)NT_X86_XSTATE)
        return done;
    const struct iovec *known = data;
    struct iovec whole = {state, sizeof state};
    if (next(PTRACE_GETREGSET, process, address, &whole) != 0 || known->iov_len > whole.iov_len)
        return done;
    memcpy(state, known->iov_base, known->iov_len);
    return next(request, process, address, &whole);
}
