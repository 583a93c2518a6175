/* Preloaded into a server, this makes its disk slow: every fsync and fdatasync takes so many milliseconds
 * longer as SLOW_DISK_MS says. Nothing else of the process is touched, unlike under a tracer, which costs
 * every thread something. */
#define _GNU_SOURCE
#include <errno.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static struct timespec delay;

__attribute__((constructor)) static void read_delay(void)
{
	const char *text = getenv("SLOW_DISK_MS");
	long milliseconds = text ? strtol(text, NULL, 10) : 0;

	delay.tv_sec = milliseconds / 1000;
	delay.tv_nsec = milliseconds % 1000 * 1000000;
}

static void wait_for_disk(void)
{
	struct timespec left = delay;

	while (nanosleep(&left, &left) != 0 && errno == EINTR)
		;
}

int fsync(int fd)
{
	wait_for_disk();
	return (int)syscall(SYS_fsync, fd);
}

int fdatasync(int fd)
{
	wait_for_disk();
	return (int)syscall(SYS_fdatasync, fd);
}
