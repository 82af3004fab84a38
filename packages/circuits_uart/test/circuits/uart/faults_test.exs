defmodule Circuits.UART.FaultsTest do
  use ExUnit.Case, async: true

  import Circuits.UART.Test.Helpers
  import ExUnit.CaptureLog

  alias Circuits.UART
  alias Circuits.UART.Server
  alias Circuits.UART.Test.Pty

  @moduletag :pty

  setup do
    {:ok, uart: start_supervised!(UART), pty: Pty.open()}
  end

  describe "hang-up" do
    test "is one message in active mode, and the port is closed", %{uart: uart, pty: %{path: path} = pty} do
      assert UART.open(uart, path) == :ok
      Pty.hang_up(pty)
      assert_receive {:circuits_uart, ^path, {:error, :eio}}
      assert UART.write(uart, "x") == {:error, :ebadf}
      assert {:closed, _options} = UART.configuration(uart)
      refute_received {:circuits_uart, _, _}
    end

    test "comes with the pid when so asked", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, id: :pid) == :ok
      Pty.hang_up(pty)
      assert_receive {:circuits_uart, ^uart, {:error, :eio}}
    end

    test "ends a read that waits", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, active: false) == :ok
      readers = for _ <- 1..3, do: Task.async(fn -> UART.read(uart, 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 3 end)
      Pty.hang_up(pty)
      assert Task.await_many(readers, 60_000) == List.duplicate({:error, :eio}, 3)
      assert UART.read(uart) == {:error, :ebadf}
      refute_received {:circuits_uart, _, _}
    end

    test "ends a write that waits", %{uart: uart, pty: %{path: path} = pty} do
      assert UART.open(uart, path) == :ok
      Pty.pause(pty)
      writers = for _ <- 1..2, do: Task.async(fn -> UART.write(uart, :binary.copy("x", 500_000), 60_000) end)
      eventually(fn -> waiting(uart, :senders) == 2 end)
      Pty.hang_up(pty)

      for result <- Task.await_many(writers, 60_000), do: assert(result in [{:error, :eio}, {:error, :ebadf}])
      assert_receive {:circuits_uart, ^path, {:error, :eio}}
    end

    test "while nobody waits is the answer of the next call in passive mode, once", %{uart: uart, pty: pty} do
      Enum.reduce([&UART.read/1, &UART.write(&1, "x")], pty, fn call, pty ->
        assert UART.open(uart, pty.path, active: false) == :ok
        Pty.hang_up(pty)
        eventually(fn -> match?({:closed, _}, UART.configuration(uart)) end)
        assert call.(uart) == {:error, :eio}
        assert call.(uart) == {:error, :ebadf}
        Pty.plug_in(pty)
      end)
    end

    test "on another device node afterwards, all works", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path) == :ok
      Pty.hang_up(pty)
      assert_receive {:circuits_uart, _, {:error, :eio}}
      # Holds the old number, so that the new one differs.
      _other = Pty.open()
      pty = Pty.plug_in(pty)
      assert UART.open(uart, pty.path) == :ok
      Pty.write(pty, "back")
      assert gather(pty.path, 4) == "back"
    end
  end

  describe "the port program killed" do
    @describetag :capture_log

    test "is :epipe; the process survives and starts another one", %{
      uart: uart,
      pty: %{path: path} = pty
    } do
      assert UART.open(uart, path) == :ok
      first = os_pid(uart)
      kill("KILL", first)
      assert_receive {:circuits_uart, ^path, {:error, :epipe}}
      assert UART.write(uart, "x") == {:error, :ebadf}

      Pty.end_exclusive(pty)
      assert UART.open(uart, path) == :ok
      assert os_pid(uart) != first
      Pty.write(pty, "x")
      assert_receive {:circuits_uart, ^path, "x"}
    end

    test "ends whatever waits", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, active: false) == :ok
      Pty.pause(pty)
      reader = Task.async(fn -> UART.read(uart, 60_000) end)
      writer = Task.async(fn -> UART.write(uart, :binary.copy("x", 500_000), 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 1 and waiting(uart, :senders) == 1 end)
      kill("KILL", os_pid(uart))
      assert Task.await(reader, 60_000) == {:error, :epipe}
      assert Task.await(writer, 60_000) == {:error, :epipe}
    end

    test "in passive mode is the answer of the next call", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, active: false) == :ok
      kill("KILL", os_pid(uart))
      eventually(fn -> match?({:closed, _}, UART.configuration(uart)) end)
      assert UART.read(uart) == {:error, :epipe}
      assert UART.read(uart) == {:error, :ebadf}
    end

    test "or stopped for a moment, as on a busy machine: it is waited for", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, active: false) == :ok
      program = os_pid(uart)
      kill("STOP", program)
      writer = Task.async(fn -> UART.write(uart, "x", 0) end)
      Process.sleep(1_500)
      kill("CONT", program)
      assert Task.await(writer, 60_000) == :ok
      assert Pty.read(pty, 1) == "x"
      assert os_pid(uart) == program
    end

    test "or stopped: it is given up, the call answered", %{uart: uart, pty: %{path: path} = pty} do
      assert UART.open(uart, path) == :ok
      stopped = os_pid(uart)
      kill("STOP", stopped)
      assert UART.write(uart, "x", 10) == {:error, :etimedout}
      assert_receive {:circuits_uart, ^path, {:error, :etimedout}}
      kill("CONT", stopped)
      # It finds its stdin closed, and goes.
      eventually(fn -> not alive?(stopped) end)
      assert UART.open(uart, path) == :ok
      Pty.write(pty, "back")
      assert gather(path, 4) == "back"
    end
  end

  describe "what is left behind" do
    test "nothing of the port program when its owner stops or is killed", %{pty: pty} do
      for stop <- [&UART.stop/1, &Process.exit(&1, :kill)] do
        uart = start_supervised!(%{id: make_ref(), start: {UART, :start_link, []}, restart: :temporary})
        assert UART.open(uart, pty.path) == :ok
        program = os_pid(uart)
        assert alive?(program)
        ref = Process.monitor(uart)
        stop.(uart)
        assert_receive {:DOWN, ^ref, _, _, _}
        eventually(fn -> not alive?(program) end)
        refute Pty.settings(pty).exclusive
      end
    end
  end

  describe "without a port program" do
    test "opening fails with words that help, said once; nothing else does", %{pty: pty} do
      {:ok, uart} = GenServer.start_link(Server, program: "/does/not/exist")

      log =
        capture_log(fn ->
          assert UART.open(uart, pty.path) == {:error, :port_program_missing}
          assert UART.open(uart, pty.path) == {:error, :port_program_missing}
        end)

      assert [_before, _after] = String.split(log, "apt-get install gcc libc6-dev")
      assert UART.configure(uart, speed: 57_600) == :ok
      assert {:closed, _options} = UART.configuration(uart)
    end
  end

  test "a program that sends something other than an answer, or ends at once, is given up" do
    # cat sends the request back.
    for program <- ["cat", "true"] do
      {:ok, uart} = GenServer.start_link(Server, program: System.find_executable(program))
      log = capture_log(fn -> assert UART.open(uart, "x") == {:error, :epipe} end)
      assert log =~ "port program"
      assert UART.write(uart, "x") == {:error, :ebadf}
    end
  end

  defp kill(signal, os_pid), do: {_, 0} = System.cmd("kill", ["-#{signal}", "#{os_pid}"])
end
