defmodule Circuits.UART.Test.Pty do
  @moduledoc """
  The other side of a serial line: a PTY's master, held by the small program `test/support/pty_peer.c`. Everything about
  it goes to and comes from the process that opened it.
  """

  defstruct [:port, :path]

  # For what is only slow on a busy machine.
  @patience 60_000

  @doc "Where the test helper builds the program."
  def program, do: Path.join(Mix.Project.app_path(), "pty_peer")

  def build! do
    source = Path.expand("pty_peer.c", __DIR__)

    {_output, 0} =
      System.cmd("cc", ["-O2", "-Wall", "-Wextra", "-Werror", "-o", program(), source], into: IO.stream())

    :ok
  end

  @doc "A new PTY; `path` is the slave, which is what a UART opens."
  def open do
    port = Port.open({:spawn_executable, program()}, [:binary, packet: 2])
    %__MODULE__{port: port, path: await(port, ?n)}
  end

  def close(pty), do: Port.close(pty.port)

  @doc "The cable is pulled: the slave is hung up."
  def hang_up(pty) do
    command(pty, "x")
    "" = await(pty.port, ?x)
    :ok
  end

  @doc "After `hang_up/1`: plugged in again, as another device."
  def plug_in(pty) do
    command(pty, "o")
    %{pty | path: await(pty.port, ?n)}
  end

  def write(pty, data) do
    for <<piece::binary-size(8_192) <- data>>, do: command(pty, ["w", piece])
    rest = rem(byte_size(data), 8_192)
    if rest > 0, do: command(pty, ["w", binary_part(data, byte_size(data) - rest, rest)])
    :ok
  end

  def pause(pty), do: command(pty, "p")
  def resume(pty), do: command(pty, "r")

  @doc """
  After a port program was killed: what the kernel does by itself when nobody has a real port open any more. Without it
  only root could open the PTY again.
  """
  def end_exclusive(pty) do
    command(pty, "u")
    false = settings(pty).exclusive
    :ok
  end

  @doc "Exactly so many bytes, as the line brings them."
  def read(pty, count, sofar \\ "")
  def read(_pty, count, sofar) when byte_size(sofar) == count, do: sofar

  def read(pty, count, sofar) do
    bytes = await(pty.port, ?d)
    true = byte_size(sofar) + byte_size(bytes) <= count
    read(pty, count, sofar <> bytes)
  end

  @doc "What the slave side has set."
  def settings(pty) do
    command(pty, "t")
    <<_cflag::32, _iflag::32, lflag::32, ispeed::32, ospeed::32, exclusive>> = await(pty.port, ?t)

    %{
      ispeed: ispeed,
      ospeed: ospeed,
      exclusive: exclusive == 1,
      raw: lflag == 0
    }
  end

  defp command(pty, packet), do: true = Port.command(pty.port, packet)

  defp await(port, type) do
    receive do
      {^port, {:data, <<^type, rest::binary>>}} -> rest
    after
      @patience -> raise "the PTY's other side did not answer with #{<<type>>}"
    end
  end
end
