defmodule Circuits.UARTTest do
  use ExUnit.Case, async: true

  import Circuits.UART.Test.Helpers

  alias Circuits.UART
  alias Circuits.UART.Test.Pty

  @moduletag :pty

  setup do
    {:ok, uart: start_supervised!(UART), pty: Pty.open()}
  end

  describe "opening" do
    test "by path, and again", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, speed: 57_600) == :ok
      assert {name, options} = UART.configuration(uart)
      assert name == pty.path
      assert options[:speed] == 57_600
      assert {uart, pty.path} in UART.find_pids()

      assert UART.open(uart, pty.path) == :ok
      Pty.write(pty, "x")
      assert gather(pty.path, 1) == "x"
    end

    @tag :tmp_dir
    test "through a link, as by-id names are", %{uart: uart, pty: pty, tmp_dir: dir} do
      link = Path.join(dir, "usb-ArduPilot_Pixhawk1_3E0024-if00")
      File.ln_s!(pty.path, link)
      assert UART.open(uart, link) == :ok
      Pty.write(pty, "x")
      assert_receive {:circuits_uart, ^link, "x"}
    end

    test "of what is not there, not a port, not a name", %{uart: uart} do
      assert UART.open(uart, "/dev/does_not_exist") == {:error, :enoent}
      assert UART.open(uart, "/dev/null") == {:error, :enotty}
      assert UART.open(uart, "/") == {:error, :eisdir}
      assert UART.open(uart, "") == {:error, :enoent}
      assert UART.open(uart, "/dev/tty\0USB0") == {:error, :enoent}
      assert UART.open(uart, String.duplicate("x", 5_000)) == {:error, :enoent}
      refute_received {:circuits_uart, _, _}
    end

    test "a second time is refused, until the first one stops", %{uart: uart, pty: pty} do
      other = start_supervised!({UART, []}, id: :other)
      assert UART.open(uart, pty.path) == :ok
      assert Pty.settings(pty).exclusive
      assert UART.open(other, pty.path) in [{:error, :eagain}, {:error, :ebusy}]

      assert UART.open(uart, "/dev/does_not_exist") == {:error, :enoent}
      refute Pty.settings(pty).exclusive
      assert UART.open(other, pty.path) == :ok
    end

    test "another port closes the first one", %{uart: uart, pty: pty} do
      second = Pty.open()
      assert UART.open(uart, pty.path, active: false) == :ok
      assert UART.open(uart, second.path, active: false) == :ok
      refute Pty.settings(pty).exclusive
      assert UART.write(uart, "second") == :ok
      assert Pty.read(second, 6) == "second"
    end

    test "keeps line settings of before, but not the mode", %{uart: uart, pty: pty} do
      assert UART.configure(uart, speed: 420_000, active: false, id: :pid) == :ok
      assert UART.open(uart, pty.path) == :ok
      assert {_name, options} = UART.configuration(uart)
      assert %{speed: 420_000, active: true, id: :name} = Map.new(options)
      assert Pty.settings(pty).ospeed == 420_000
    end

    test "what cannot be opened leaves the process usable", %{uart: uart, pty: pty} do
      assert UART.open(uart, "/dev/does_not_exist") == {:error, :enoent}
      assert UART.write(uart, "x") == {:error, :ebadf}
      assert UART.open(uart, pty.path) == :ok
      assert UART.open(uart, "/dev/does_not_exist") == {:error, :enoent}
      assert {:closed, _options} = UART.configuration(uart)
    end
  end

  describe "settings" do
    test "any baud rate reaches the line", %{uart: uart, pty: pty} do
      for speed <- [9_600, 57_600, 115_200, 420_000, 921_600, 1_234_567, 31_250, 1] do
        assert UART.open(uart, pty.path, speed: speed) == :ok
        assert %{ospeed: ^speed, ispeed: ^speed, raw: true} = Pty.settings(pty)
      end
    end

    test "change while open", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, speed: 57_600) == :ok
      assert UART.configure(uart, speed: 115_200, active: false) == :ok
      assert %{ospeed: 115_200, raw: true} = Pty.settings(pty)
      assert {_name, options} = UART.configuration(uart)
      assert %{active: false, speed: 115_200} = Map.new(options)
    end

    test "that mean nothing are refused and change nothing", %{uart: uart, pty: pty} do
      bad = [
        [speed: -1],
        [speed: 0],
        [speed: 0x100000000],
        [speed: 57_600.0],
        [speed: "57600"],
        [active: :once],
        [id: :port],
        [sped: 57_600],
        [:active],
        %{speed: 57_600}
      ]

      for options <- bad,
          do: assert({options, UART.open(uart, pty.path, options)} == {options, {:error, :einval}})

      assert UART.open(uart, pty.path, speed: 57_600) == :ok
      for options <- bad, do: assert({options, UART.configure(uart, options)} == {options, {:error, :einval}})
      assert Pty.settings(pty).ospeed == 57_600
      assert UART.write(uart, "still here") == :ok
      assert Pty.read(pty, 10) == "still here"
    end
  end

  describe "active mode" do
    test "tells the name or the pid, whole and in order", %{uart: uart, pty: %{path: path} = pty} do
      assert UART.open(uart, path) == :ok
      Pty.write(pty, "by name")
      assert gather(path, 7) == "by name"

      assert UART.configure(uart, id: :pid) == :ok
      Pty.write(pty, "by pid")
      assert gather(uart, 6) == "by pid"
      assert UART.read(uart) == {:error, :einval}
    end

    test "leaves every byte as it is", %{uart: uart, pty: pty} do
      all = for byte <- 0..255, into: "", do: <<byte>>
      assert UART.open(uart, pty.path) == :ok
      Pty.write(pty, all)
      assert gather(pty.path, 256) == all
      assert UART.write(uart, all, 60_000) == :ok
      assert Pty.read(pty, 256) == all
    end

    test "goes to the controlling process", %{uart: uart, pty: %{path: path} = pty} do
      test = self()
      assert Task.await(Task.async(fn -> UART.open(uart, path) end)) == :ok
      other = spawn_link(fn -> receive do: (message -> send(test, {:other, message})) end)
      assert UART.controlling_process(uart, other) == :ok
      Pty.write(pty, "x")
      assert_receive {:other, {:circuits_uart, ^path, "x"}}
    end

    test "and passive mode take turns without losing a byte", %{uart: uart, pty: %{path: path} = pty} do
      assert UART.open(uart, path, active: false) == :ok
      Pty.write(pty, "a")
      assert UART.read(uart, 60_000) == {:ok, "a"}
      assert UART.configure(uart, active: true) == :ok
      Pty.write(pty, "b")
      assert_receive {:circuits_uart, ^path, "b"}
      assert UART.configure(uart, active: false) == :ok
      Pty.write(pty, "c")
      assert UART.read(uart, 60_000) == {:ok, "c"}
      refute_received {:circuits_uart, _, _}
      Pty.write(pty, "d")
      assert UART.configure(uart, active: true) == :ok
      assert_receive {:circuits_uart, ^path, "d"}
    end
  end

  describe "passive mode" do
    setup %{uart: uart, pty: pty} do
      UART.open(uart, pty.path, active: false)
    end

    test "reads what is there, or nothing when the time is over", %{uart: uart, pty: pty} do
      assert UART.read(uart, 0) == {:ok, ""}
      assert UART.read(uart, 20) == {:ok, ""}
      Pty.write(pty, "hello")
      assert UART.read(uart, 60_000) == {:ok, "hello"}
    end

    test "a read that waits does not keep others waiting", %{uart: uart, pty: pty} do
      reader = Task.async(fn -> UART.read(uart, 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 1 end)
      assert UART.write(uart, "question") == :ok
      assert UART.drain(uart) == :ok
      assert Pty.read(pty, 8) == "question"
      Pty.write(pty, "answer")
      assert Task.await(reader, 60_000) == {:ok, "answer"}
    end

    test "readers are served in order, each with its own time", %{uart: uart, pty: pty} do
      first = Task.async(fn -> UART.read(uart, 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 1 end)
      assert UART.read(uart, 10) == {:ok, ""}
      third = Task.async(fn -> UART.read(uart, 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 2 end)

      Pty.write(pty, "1")
      assert Task.await(first, 60_000) == {:ok, "1"}
      Pty.write(pty, "3")
      assert Task.await(third, 60_000) == {:ok, "3"}
    end

    test "what is not read stays with the kernel, which holds the sender back", %{uart: uart, pty: pty} do
      data = :binary.copy("0123456789abcdef", 65_536)
      Pty.write(pty, data)
      assert read_all(uart, byte_size(data)) == data
    end

    test "a reader's death costs nobody else anything", %{uart: uart, pty: pty} do
      {reader, ref} = spawn_monitor(fn -> UART.read(uart, 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 1 end)
      Process.exit(reader, :kill)
      assert_receive {:DOWN, ^ref, _, _, :killed}
      Pty.write(pty, "its own")
      eventually(fn -> waiting(uart, :readers) == 0 end)
      Pty.write(pty, "not its own")
      assert UART.read(uart, 60_000) == {:ok, "not its own"}
    end

    test "opening again ends the waiting", %{uart: uart, pty: pty} do
      reader = Task.async(fn -> UART.read(uart, 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 1 end)
      assert UART.open(uart, pty.path, active: false) == :ok
      assert Task.await(reader, 60_000) == {:error, :ecanceled}
    end

    test "turning it off ends the waiting too", %{uart: uart} do
      reader = Task.async(fn -> UART.read(uart, 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 1 end)
      assert UART.configure(uart, active: true) == :ok
      assert Task.await(reader, 60_000) == {:error, :ecanceled}
    end
  end

  describe "writing" do
    test "takes iodata, and raises in the caller for anything else", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path) == :ok
      assert UART.write(uart, [~c"AB", ?C, ["D", []], "EF"]) == :ok
      assert UART.write(uart, "") == :ok
      assert Pty.read(pty, 6) == "ABCDEF"
      assert_raise ArgumentError, fn -> UART.write(uart, [:not_iodata]) end
    end

    test "goes on where the line left off, and ends with its time", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path) == :ok
      data = :crypto.strong_rand_bytes(1_000_000)
      Pty.pause(pty)
      assert UART.write(uart, data, 50) == {:error, :eagain}
      assert UART.write(uart, data, 0) == {:error, :eagain}
      assert UART.configure(uart, speed: 9_600) == :ok
      assert {:ok, :ok} = Task.yield(Task.async(fn -> UART.stop(uart) end), 60_000)
    end

    test "a line that takes nothing keeps no other call waiting", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, active: false) == :ok
      Pty.pause(pty)
      data = :binary.copy("x", 500_000)
      writer = Task.async(fn -> UART.write(uart, data, 60_000) end)
      eventually(fn -> waiting(uart, :senders) == 1 end)
      assert UART.write(uart, "behind", 10) == {:error, :eagain}
      Pty.write(pty, "incoming")
      assert UART.read(uart, 60_000) == {:ok, "incoming"}
      assert UART.configure(uart, speed: 115_200) == :ok

      Pty.resume(pty)
      assert Pty.read(pty, 500_000) == data
      assert Task.await(writer, 60_000) == :ok
    end

    test "when nothing is open", %{uart: uart} do
      assert UART.write(uart, "x") == {:error, :ebadf}
      assert UART.read(uart) == {:error, :ebadf}
      assert UART.flush(uart, :receive) == {:error, :ebadf}
      assert UART.drain(uart) == {:error, :ebadf}
    end
  end

  test "a flush drops what was received and not read", %{uart: uart, pty: pty} do
    assert UART.open(uart, pty.path, active: false) == :ok
    Pty.write(pty, "one")
    assert UART.read(uart, 60_000) == {:ok, "one"}
    Pty.write(pty, "two")
    # Both have passed the line when the settings, which follow them, are there.
    %{raw: true} = Pty.settings(pty)
    assert UART.flush(uart, :receive) == :ok
    assert UART.read(uart, 0) == {:ok, ""}
    Pty.write(pty, "three")
    assert UART.read(uart, 60_000) == {:ok, "three"}
  end

  test "two megabytes each way at once, without loss", %{uart: uart, pty: %{path: path} = pty} do
    down = :crypto.strong_rand_bytes(2_000_000)
    up = :crypto.strong_rand_bytes(2_000_000)
    assert UART.open(uart, path, speed: 921_600) == :ok
    writer = Task.async(fn -> UART.write(uart, up, 60_000) end)
    Pty.write(pty, down)
    assert gather(path, 2_000_000) == down
    assert Pty.read(pty, 2_000_000) == up
    assert Task.await(writer, 60_000) == :ok
  end
end
