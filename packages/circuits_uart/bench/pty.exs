# How much a UART costs, over a PTY with the tests' peer: MIX_ENV=test mix run bench/pty.exs
#
# Round trip: this process -> UART -> line -> other side -> UART -> this process. Half of the way back is the other
# side's, so the figure is an upper bound. Flood: bytes as fast as the line takes them.
alias Circuits.UART
alias Circuits.UART.Test.{Helpers, Pty}

Pty.build!()
pty = Pty.open()
path = pty.path
{:ok, uart} = UART.start_link()
:ok = UART.open(uart, path, speed: 921_600)

frame = :binary.copy(<<0xFD>>, 40)

times =
  for _ <- 1..5_000 do
    start = System.monotonic_time(:nanosecond)
    :ok = UART.write(uart, frame)
    ^frame = Pty.read(pty, 40)
    Pty.write(pty, frame)
    ^frame = Helpers.gather(path, 40)
    System.monotonic_time(:nanosecond) - start
  end
  |> Enum.sort()

quantile = fn q -> Float.round(Enum.at(times, trunc(q * length(times))) / 1_000, 1) end
IO.puts("round trip of 40 bytes, both sides: p50 #{quantile.(0.5)} us, p99 #{quantile.(0.99)} us")

data = :crypto.strong_rand_bytes(16_000_000)
{down, ^data} = :timer.tc(fn -> Pty.write(pty, data) && Helpers.gather(path, byte_size(data)) end)
writer = Task.async(fn -> UART.write(uart, data, 60_000) end)
{up, ^data} = :timer.tc(fn -> Pty.read(pty, byte_size(data)) end)
:ok = Task.await(writer)

for {name, us} <- [received: down, sent: up] do
  IO.puts("16 MB #{name}: #{Float.round(byte_size(data) / us, 1)} MB/s")
end
