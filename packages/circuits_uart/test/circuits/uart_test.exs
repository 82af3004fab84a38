defmodule Circuits.UARTTest do
  use ExUnit.Case, async: true

  import Circuits.UART.Test.Helpers

  alias Circuits.UART
  alias Circuits.UART.Framing
  alias Circuits.UART.Test.Pty

  @moduletag :pty

  setup do
    {:ok, uart: start_supervised!(UART), pty: Pty.open()}
  end

  describe "opening" do
    test "by path, closing, opening again", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, speed: 57_600) == :ok
      assert {name, options} = UART.configuration(uart)
      assert name == pty.path
      assert options[:speed] == 57_600
      assert {uart, pty.path} in UART.find_pids()

      assert UART.close(uart) == :ok
      assert {:closed, _options} = UART.configuration(uart)
      assert UART.close(uart) == :ok
      assert UART.open(uart, pty.path) == :ok
    end

    test "by a name in /dev", %{uart: uart, pty: %{path: "/dev/" <> name} = pty} do
      assert UART.open(uart, name) == :ok
      Pty.write(pty, "x")
      assert_receive {:circuits_uart, ^name, "x"}
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
      assert UART.open(uart, "does_not_exist") == {:error, :enoent}
      assert UART.open(uart, "/dev/null") == {:error, :enotty}
      assert UART.open(uart, "/") == {:error, :eisdir}
      assert UART.open(uart, "") in [{:error, :enoent}, {:error, :eisdir}]
      assert UART.open(uart, "tty\0USB0") == {:error, :enoent}
      assert UART.open(uart, String.duplicate("x", 5_000)) == {:error, :enoent}
      refute_received {:circuits_uart, _, _}
    end

    test "a second time is refused, until the first one closes", %{uart: uart, pty: pty} do
      other = start_supervised!({UART, []}, id: :other)
      assert UART.open(uart, pty.path) == :ok
      assert Pty.settings(pty).exclusive
      assert UART.open(other, pty.path) in [{:error, :eagain}, {:error, :ebusy}]

      assert UART.close(uart) == :ok
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
      assert UART.open(uart, "does_not_exist") == {:error, :enoent}
      assert UART.write(uart, "x") == {:error, :ebadf}
      assert UART.open(uart, pty.path) == :ok
      assert UART.open(uart, "does_not_exist") == {:error, :enoent}
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
      assert UART.open(uart, pty.path, active: false, speed: 57_600) == :ok
      assert UART.configure(uart, speed: 115_200, flow_control: :hardware, stop_bits: 2, parity: :odd) == :ok

      assert %{ospeed: 115_200, hardware_flow: true, software_flow: false, stop_bits: 2, odd: true} =
               Pty.settings(pty)

      assert UART.configure(uart, flow_control: :software) == :ok
      assert %{ospeed: 115_200, hardware_flow: false, software_flow: true} = Pty.settings(pty)
      assert {_name, options} = UART.configuration(uart)
      assert %{active: false, flow_control: :software, stop_bits: 2, parity: :odd} = Map.new(options)
    end

    test "that mean nothing are refused and change nothing", %{uart: uart, pty: pty} do
      bad = [
        [speed: -1],
        [speed: 0],
        [speed: 0x100000000],
        [speed: 57_600.0],
        [speed: "57600"],
        [data_bits: 9],
        [stop_bits: 3],
        [parity: :strange],
        [flow_control: nil],
        [active: :once],
        [id: :port],
        [framing: Circuits.UART.NoSuchFraming],
        [framing: {Framing.Line, separator: ""}],
        [framing: "line"],
        [rx_framing_timeout: :infinity],
        [rs485_enabled: 1],
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
      assert UART.configure(uart, framing: Framing.Line) == :ok
      {reader, ref} = spawn_monitor(fn -> UART.read(uart, 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 1 end)
      Process.exit(reader, :kill)
      assert_receive {:DOWN, ^ref, _, _, :killed}
      Pty.write(pty, "its own\nnot its own\n")
      assert UART.read(uart, 60_000) == {:ok, "not its own"}
    end

    test "closing ends the waiting", %{uart: uart} do
      reader = Task.async(fn -> UART.read(uart, 60_000) end)
      eventually(fn -> waiting(uart, :readers) == 1 end)
      assert UART.close(uart) == :ok
      assert Task.await(reader, 60_000) == {:error, :ecanceled}
      assert UART.read(uart) == {:error, :ebadf}
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
      assert UART.flush(uart, :both) == :ok
      assert UART.configure(uart, speed: 9_600) == :ok
      assert {:ok, _} = Task.yield(Task.async(fn -> UART.close(uart) end), 30_000)
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
      assert UART.flush(uart) == {:error, :ebadf}
      assert UART.drain(uart) == {:error, :ebadf}
      assert UART.signals(uart) == {:error, :ebadf}
      assert UART.set_rts(uart, true) == {:error, :ebadf}
      assert UART.set_dtr(uart, true) == {:error, :ebadf}
      assert UART.set_break(uart, true) == {:error, :ebadf}
      assert UART.send_break(uart, 1) == {:error, :ebadf}
    end
  end

  describe "flush" do
    test "drops what was received, with parts of frames and messages nobody read", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, active: false, framing: Framing.Line) == :ok
      Pty.write(pty, "one\ntwo\nthr")
      assert UART.read(uart, 60_000) == {:ok, "one"}
      assert UART.flush(uart, :receive) == :ok
      assert UART.read(uart, 0) == {:ok, ""}
      Pty.write(pty, "ee\n")
      assert UART.read(uart, 60_000) == {:ok, "ee"}
    end

    test "of the transmit direction leaves the received alone", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, active: false, framing: Framing.Line) == :ok
      Pty.write(pty, "one\ntwo\n")
      assert UART.read(uart, 60_000) == {:ok, "one"}
      assert UART.flush(uart, :transmit) == :ok
      assert UART.read(uart, 60_000) == {:ok, "two"}
      assert UART.flush(uart, :sideways) == {:error, :einval}
    end
  end

  test "drain, signals and break say what the line says", %{uart: uart, pty: pty} do
    assert UART.open(uart, pty.path) == :ok
    assert UART.write(uart, "x") == :ok
    assert UART.drain(uart) == :ok
    # A PTY has no modem lines.
    assert {:error, reason} = UART.signals(uart)
    assert reason in [:enotty, :einval]
    assert UART.set_rts(uart, true) == {:error, reason}
    assert UART.set_dtr(uart, false) == {:error, reason}
    assert UART.set_break(uart, true) == :ok
    assert UART.set_break(uart, false) == :ok
    assert UART.send_break(uart, 5) == :ok
  end

  describe "framing" do
    test "in both directions", %{uart: uart, pty: %{path: path} = pty} do
      assert UART.open(uart, path, framing: {Framing.Line, separator: "\r\n"}) == :ok
      assert UART.write(uart, "AT") == :ok
      assert Pty.read(pty, 4) == "AT\r\n"
      Pty.write(pty, "O")
      Pty.write(pty, "K\r")
      Pty.write(pty, "\n\r\nend\r\n")
      assert_receive {:circuits_uart, ^path, "OK"}
      assert_receive {:circuits_uart, ^path, ""}
      assert_receive {:circuits_uart, ^path, "end"}
    end

    test "a frame that does not go on is told after its time", %{uart: uart, pty: %{path: path} = pty} do
      assert UART.open(uart, path, framing: Framing.Line, rx_framing_timeout: 20) == :ok
      Pty.write(pty, "par")
      assert_receive {:circuits_uart, ^path, {:partial, "par"}}

      assert UART.configure(uart, active: false, framing: Framing.FourByte) == :ok
      Pty.write(pty, "123456")
      assert UART.read(uart, 60_000) == {:ok, "1234"}
      assert UART.read(uart, 60_000) == {:ok, "56"}
    end

    test "may be changed; what nobody read comes first", %{uart: uart, pty: %{path: path} = pty} do
      assert UART.open(uart, path, active: false, framing: {Framing.Line, max_length: 4}) == :ok
      Pty.write(pty, "first\nsecond\n")
      assert UART.read(uart, 60_000) == {:ok, {:partial, "firs"}}
      assert UART.configure(uart, active: true, framing: Framing.None) == :ok
      assert_receive {:circuits_uart, ^path, "t"}
      assert_receive {:circuits_uart, ^path, {:partial, "seco"}}
      assert_receive {:circuits_uart, ^path, "nd"}
      Pty.write(pty, "raw")
      assert gather(path, 3) == "raw"
    end

    test "a part of a frame outlives a change of speed", %{uart: uart, pty: %{path: path} = pty} do
      assert UART.open(uart, path, active: false, framing: Framing.Line) == :ok
      Pty.write(pty, "be")
      assert UART.read(uart, 50) == {:ok, ""}
      assert UART.configure(uart, speed: 115_200) == :ok
      Pty.write(pty, "gun\n")
      assert UART.read(uart, 60_000) == {:ok, "begun"}
    end

    test "an error of a framing is the caller's, not the process's", %{uart: uart, pty: pty} do
      assert UART.open(uart, pty.path, framing: Circuits.UART.Test.PickyFraming) == :ok
      assert UART.write(uart, "no") == {:error, :not_this}
      assert UART.write(uart, "yes") == :ok
      assert Pty.read(pty, 3) == "yes"

      assert UART.open(uart, pty.path, framing: {Circuits.UART.Test.PickyFraming, :bad}) ==
               {:error, :bad_args}

      assert UART.write(uart, "yes") == :ok
    end
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

  test "the names that the namesake has are there" do
    functions = [
      child_spec: 1,
      close: 1,
      configuration: 1,
      configure: 2,
      controlling_process: 2,
      drain: 1,
      enumerate: 0,
      find_pids: 0,
      flush: 1,
      flush: 2,
      open: 2,
      open: 3,
      read: 1,
      read: 2,
      send_break: 1,
      send_break: 2,
      set_break: 2,
      set_dtr: 2,
      set_rts: 2,
      signals: 1,
      start_link: 0,
      start_link: 1,
      stop: 1,
      write: 2,
      write: 3
    ]

    assert Circuits.UART.__info__(:functions) == functions
  end
end
