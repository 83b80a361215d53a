/* Lets User-Mode Linux run on a processor whose registers are larger than it knows (Intel's AMX).
 *
 * Linux takes the extended registers of a traced process (NT_X86_XSTATE) only as a whole, and User-Mode Linux 6.1 gives
 * those that it knows: "ptrace set fp regs failed, errno = 14". Preloaded, this gives the rest as it is.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

static char whole[1 << 16] __attribute__((aligned(64))); /* its stacks are small, and it has one thread */

long ptrace(enum __ptrace_request request, ...)
{
	static long (*real)(enum __ptrace_request, ...);
	va_list rest;
	va_start(rest, request);
	long process = va_arg(rest, long);
	void *set = va_arg(rest, void *), *data = va_arg(rest, void *);
	va_end(rest);
	if (!real)
		real = (long (*)(enum __ptrace_request, ...))dlsym(RTLD_NEXT, "ptrace");
	if (request == PTRACE_SETREGSET && set == (void *)NT_X86_XSTATE) {
		struct iovec *part = data, all = {whole, sizeof whole};
		long failed = real(PTRACE_GETREGSET, process, set, &all);
		if (failed)
			return failed;
		memcpy(whole, part->iov_base, part->iov_len < all.iov_len ? part->iov_len : all.iov_len);
		return real(PTRACE_SETREGSET, process, set, &all);
	}
	return real(request, process, set, data);
}
