/* A /dev/spidev0.0 in user space (CUSE): enough of the kernel's interface for py-spidev.
 *
 * Every byte written goes to the file $SPI_LOG, in records of
 *     1 byte  D/C, '0' or '1', as the GPIO line $DC_LINE had it,
 *     4 bytes number of data bytes, little endian,
 *     the data bytes.
 * The interface is that of Documentation/spi/spidev.rst in Linux; libfuse's cuse_lowlevel.h carries it.
 */
#define FUSE_USE_VERSION 31
#include <cuse_lowlevel.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/spi/spidev.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { BUFFER = 4096, MOST_TRANSFERS = 8 }; /* spidev's bufsiz, and what one message may hold here */

static uint8_t mode, lsb_first, bits = 8;
static uint32_t mode32, speed = 500000;
static int log_file;
static const char *dc_line;

static void append(const void *data, size_t length)
{
    if (write(log_file, data, length) != (ssize_t)length)
        abort(); /* a log with holes would prove nothing */
}

static void record(const void *data, uint32_t length)
{
    uint8_t head[5] = {'?', length, length >> 8, length >> 16, length >> 24};
    int line = open(dc_line, O_RDONLY);
    if (line < 0 || read(line, head, 1) != 1)
        abort();
    close(line);
    append(head, sizeof head);
    append(data, length);
}

static void on_open(fuse_req_t request, struct fuse_file_info *info)
{
    fuse_reply_open(request, info);
}

static void on_write(fuse_req_t request, const char *data, size_t length, off_t offset,
                     struct fuse_file_info *info)
{
    (void)offset, (void)info;
    if (length > BUFFER) {
        fuse_reply_err(request, EMSGSIZE);
        return;
    }
    record(data, length);
    fuse_reply_write(request, length);
}

/* A setting is read or written through a pointer: the kernel is asked for its target first. */
static void setting(fuse_req_t request, void *pointer, void *value, size_t size, int writes,
                    const void *in, size_t in_size, size_t out_size)
{
    struct iovec target = {pointer, size};
    if (writes && !in_size)
        fuse_reply_ioctl_retry(request, &target, 1, NULL, 0);
    else if (writes) {
        memcpy(value, in, size);
        fuse_reply_ioctl(request, 0, NULL, 0);
    } else if (!out_size)
        fuse_reply_ioctl_retry(request, NULL, 0, &target, 1);
    else
        fuse_reply_ioctl(request, 0, value, size);
}

/* A message is an array of transfers, each of which points to what is sent and received. */
static void message(fuse_req_t request, void *pointer, size_t size, const void *in, size_t in_size)
{
    struct iovec sent[1 + MOST_TRANSFERS] = {{pointer, size}}, received[MOST_TRANSFERS];
    size_t count = size / sizeof(struct spi_ioc_transfer), tx = 0, rx = 0;
    int senders = 1, receivers = 0;
    if (!in_size) {
        fuse_reply_ioctl_retry(request, sent, 1, NULL, 0);
        return;
    }
    if (count > MOST_TRANSFERS) {
        fuse_reply_err(request, EMSGSIZE);
        return;
    }
    const struct spi_ioc_transfer *transfers = in;
    for (size_t i = 0; i < count; i++) {
        if (transfers[i].tx_buf) {
            sent[senders++] =
                (struct iovec){(void *)(uintptr_t)transfers[i].tx_buf, transfers[i].len};
            tx += transfers[i].len;
        }
        if (transfers[i].rx_buf) {
            received[receivers++] =
                (struct iovec){(void *)(uintptr_t)transfers[i].rx_buf, transfers[i].len};
            rx += transfers[i].len;
        }
    }
    if (tx > BUFFER) {
        fuse_reply_err(request, EMSGSIZE);
        return;
    }
    if (in_size == size && tx) {
        fuse_reply_ioctl_retry(request, sent, senders, received, receivers);
        return;
    }
    if (tx)
        record((const uint8_t *)in + size, tx);
    void *nothing = calloc(1, rx + 1); /* nobody answers on this bus */
    fuse_reply_ioctl(request, tx, nothing, rx);
    free(nothing);
}

static void on_ioctl(fuse_req_t request, int command, void *pointer, struct fuse_file_info *info,
                     unsigned flags, const void *in, size_t in_size, size_t out_size)
{
    (void)info, (void)flags;
    struct { unsigned read, write; void *value; size_t size; } settings[] = {
        {SPI_IOC_RD_MODE, SPI_IOC_WR_MODE, &mode, sizeof mode},
        {SPI_IOC_RD_LSB_FIRST, SPI_IOC_WR_LSB_FIRST, &lsb_first, sizeof lsb_first},
        {SPI_IOC_RD_BITS_PER_WORD, SPI_IOC_WR_BITS_PER_WORD, &bits, sizeof bits},
        {SPI_IOC_RD_MAX_SPEED_HZ, SPI_IOC_WR_MAX_SPEED_HZ, &speed, sizeof speed},
        {SPI_IOC_RD_MODE32, SPI_IOC_WR_MODE32, &mode32, sizeof mode32},
    };
    unsigned asked = command;
    for (size_t i = 0; i < sizeof settings / sizeof *settings; i++)
        if (asked == settings[i].read || asked == settings[i].write) {
            setting(request, pointer, settings[i].value, settings[i].size,
                    asked == settings[i].write, in, in_size, out_size);
            return;
        }
    if (_IOC_TYPE(asked) == SPI_IOC_MAGIC && _IOC_NR(asked) == 0)
        message(request, pointer, _IOC_SIZE(asked), in, in_size);
    else
        fuse_reply_err(request, ENOTTY);
}

int main(int count, char **arguments)
{
    const char *name[] = {"DEVNAME=spidev0.0"};
    struct cuse_info info = {
        .dev_info_argc = 1, .dev_info_argv = name, .flags = CUSE_UNRESTRICTED_IOCTL};
    struct cuse_lowlevel_ops operations = {.open = on_open, .write = on_write, .ioctl = on_ioctl};
    dc_line = getenv("DC_LINE");
    log_file = open(getenv("SPI_LOG"), O_WRONLY | O_CREAT | O_TRUNC | O_APPEND, 0644);
    if (!dc_line || log_file < 0)
        return 1;
    return cuse_lowlevel_main(count, arguments, &info, &operations, NULL);
}
