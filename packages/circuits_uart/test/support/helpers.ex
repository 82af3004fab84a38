defmodule Circuits.UART.Test.Helpers do
  @moduledoc "What several tests do."

  import ExUnit.Assertions

  alias Circuits.UART

  # For what is only slow on a busy machine.
  @patience 60_000

  @doc "So many bytes of active mode's messages."
  def gather(id, count, sofar \\ "")
  def gather(_id, count, sofar) when byte_size(sofar) >= count, do: sofar

  def gather(id, count, sofar) do
    assert_receive {:circuits_uart, ^id, data} when is_binary(data), @patience
    gather(id, count, sofar <> data)
  end

  @doc "So many bytes of passive mode."
  def read_all(uart, count, sofar \\ "")
  def read_all(_uart, count, sofar) when byte_size(sofar) >= count, do: sofar

  def read_all(uart, count, sofar) do
    assert {:ok, data} = UART.read(uart, @patience)
    assert data != ""
    read_all(uart, count, sofar <> data)
  end

  @doc "How many callers wait in a queue of the serving process."
  def waiting(uart, queue), do: :queue.len(Map.fetch!(:sys.get_state(uart, 60_000).core, queue))

  @doc "The operating system's id of the port program."
  def os_pid(uart) do
    {:links, links} = Process.info(uart, :links)
    port = Enum.find(links, &is_port/1)
    {:os_pid, os_pid} = Port.info(port, :os_pid)
    os_pid
  end

  @doc "Whether that process of the operating system runs; one that ended and is not reaped yet does not."
  def alive?(os_pid) do
    case File.read("/proc/#{os_pid}/stat") do
      {:ok, stat} -> not (stat =~ ~r/\) [ZX] /)
      {:error, _gone} -> false
    end
  end

  @doc "For facts of the operating system that nothing tells."
  def eventually(fun, deadline \\ System.monotonic_time(:millisecond) + @patience) do
    cond do
      result = fun.() ->
        result

      System.monotonic_time(:millisecond) > deadline ->
        flunk("did not become true")

      true ->
        receive do
        after
          5 -> eventually(fun, deadline)
        end
    end
  end
end
