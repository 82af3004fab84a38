defmodule Circuits.UART.LeakTest do
  # Counts what the whole node has, so nothing else may run.
  use ExUnit.Case, async: false

  import Circuits.UART.Test.Helpers

  alias Circuits.UART
  alias Circuits.UART.Test.Pty

  @moduletag :pty

  setup do
    {:ok, uart: start_supervised!(UART), pty: Pty.open()}
  end

  test "200 times pulled and put back under traffic: no descriptor, process, port or atom", %{
    uart: uart,
    pty: pty
  } do
    pty = Enum.reduce(1..10, pty, &pulled(uart, &1, &2))
    program = os_pid(uart)
    before = census(uart, program)
    Enum.reduce(1..200, pty, &pulled(uart, &1, &2))
    assert os_pid(uart) == program
    assert_same(before, uart, program)
  end

  test "200 times opened, which closes the one before: the same", %{uart: uart, pty: pty} do
    for _ <- 1..10, do: opened_again(uart, pty)
    program = os_pid(uart)
    before = census(uart, program)
    for _ <- 1..200, do: opened_again(uart, pty)
    assert_same(before, uart, program)
  end

  @tag :capture_log
  test "50 port programs killed: the same", %{uart: uart, pty: pty} do
    for _ <- 1..5, do: killed(uart, pty)
    opened_again(uart, pty)
    before = census(uart, os_pid(uart))
    for _ <- 1..50, do: killed(uart, pty)
    opened_again(uart, pty)
    assert_same(before, uart, os_pid(uart))
  end

  defp pulled(uart, _round, %{path: path} = pty) do
    assert UART.open(uart, path, speed: 57_600) == :ok
    Pty.write(pty, "telemetry")
    assert UART.write(uart, "commands", 60_000) == :ok
    assert_receive {:circuits_uart, ^path, data} when is_binary(data)
    Pty.hang_up(pty)
    await_error(path, :eio)
    forget(pty)
    Pty.plug_in(pty)
  end

  defp opened_again(uart, pty) do
    assert UART.open(uart, pty.path, active: false) == :ok
    assert UART.write(uart, "x", 60_000) == :ok
    assert Pty.read(pty, 1) == "x"
  end

  defp killed(uart, %{path: path} = pty) do
    assert UART.open(uart, pty.path) == :ok
    {_, 0} = System.cmd("kill", ["-KILL", "#{os_pid(uart)}"])
    await_error(path, :epipe)
    Pty.end_exclusive(pty)
  end

  defp await_error(path, reason) do
    assert_receive {:circuits_uart, ^path, data}
    if is_binary(data), do: await_error(path, reason), else: assert(data == {:error, reason})
  end

  # What the line brought the other side before it was pulled.
  defp forget(%{port: port} = pty) do
    receive do
      {^port, {:data, _}} -> forget(pty)
    after
      0 -> :ok
    end
  end

  # What the node does besides (loggers, code loading) comes and goes: it has to settle to what it was.
  defp assert_same(before, uart, program) do
    eventually(fn -> census(uart, program) == before end)
  catch
    :error, %ExUnit.AssertionError{} -> assert census(uart, program) == before
  end

  defp census(uart, program) do
    server = :sys.get_state(uart, 60_000)

    %{
      descriptors: program |> then(&File.ls!("/proc/#{&1}/fd")) |> length(),
      processes: length(Process.list()),
      ports: length(Port.list()),
      atoms: :erlang.system_info(:atom_count),
      links: uart |> Process.info(:links) |> elem(1) |> length(),
      timers: map_size(server.timers),
      pending: map_size(server.core.pending),
      mailboxes: {Process.info(uart, :message_queue_len), Process.info(self(), :message_queue_len)}
    }
  end
end
