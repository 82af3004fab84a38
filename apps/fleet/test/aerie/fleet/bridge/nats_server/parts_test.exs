defmodule Aerie.Fleet.Bridge.NatsServer.PartsTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Files.FolderLock
  alias Aerie.Fleet.Bridge.NatsServer.{LogFile, LogLine, OsProcess, Settings}

  doctest LogLine

  @moduletag :tmp_dir

  test "the server understands its configuration, whatever the folder is called", %{tmp_dir: dir} do
    for name <- ["plain", "with space", ~s(quo"te), "ünïcode", "semi;colon#hash", "back\\slash"] do
      folder = Path.join(dir, name)
      File.mkdir_p!(folder)
      conf = Path.join(folder, "nats.conf")

      settings = %{
        name: "aerie-1",
        address: "127.0.0.1",
        port: 0,
        store_dir: folder,
        max_memory_mb: 1,
        max_store_mb: 2,
        token: "t",
        domain: nil,
        leaf: %{url: []},
        seed: nil
      }

      File.write!(conf, Settings.render(settings))
      assert {_, 0} = System.cmd("nats-server", ["-t", "-c", conf], stderr_to_stdout: true)
    end
  end

  test "lines of its log" do
    time = "[7] 2026/11/20 22:22:41.702000"
    assert LogLine.parse("#{time} [WRN] careful") == {:warning, "careful", nil}

    for text <- [
          "Filestore [FLEET_EVENTS] Critical write error: write /var/1.blk: no space left on device",
          "JetStream failed to store a msg on stream '$G > FLEET_EVENTS': write /var/1.blk: no space left on device"
        ],
        do:
          assert(
            {:error, ^text, {:write_error, "no space left on device"}} =
              LogLine.parse("#{time} [ERR] #{text}")
          )

    assert {:error, _, :port_taken} =
             LogLine.parse("#{time} [FTL] Error listening: bind: address already in use")

    assert {:debug, _, {:listening, 4222}} =
             LogLine.parse("#{time} [INF] Listening for client connections on 127.0.0.1:4222")

    assert {:debug, _, {:listening, 4222}} =
             LogLine.parse("#{time} [INF] Listening for client connections on [::1]:4222")

    assert LogLine.parse("nats-server: no such flag") == {:warning, "nats-server: no such flag", nil}
    assert {:warning, _, nil} = LogLine.parse(<<255, 0, 1>>)
  end

  test "of lines that differ in numbers alone one a minute is written, and says how many were not" do
    {written, _seen} =
      Enum.flat_map_reduce(0..179, %{}, fn second, seen ->
        text = "Error trying to connect as leafnode to remote server \"hub:7422\" (attempt #{second})"
        {left_out, seen} = LogLine.observe(seen, text, second * 1000)
        {List.wrap(left_out), seen}
      end)

    assert written == [0, 59, 59]
  end

  test "another line is written at once, and what is remembered stays small" do
    {0, seen} = LogLine.observe(%{}, "Server is ready", 0)
    assert {0, seen} = LogLine.observe(seen, "Leafnode connection created", 1)

    seen =
      for a <- ?a..?z, b <- ?a..?z, reduce: seen do
        seen -> seen |> LogLine.observe(<<a, b>>, 2) |> elem(1)
      end

    assert map_size(seen) <= 100
  end

  test "the log on disk stays small", %{tmp_dir: dir} do
    path = Path.join(dir, "log")
    line = String.duplicate("x", 1_000)
    log = Enum.reduce(1..2_000, LogFile.open(path), fn _, log -> LogFile.write(log, line) end)
    LogFile.close(log)
    assert File.ls!(dir) |> Enum.sort() == ["log", "log.1"]
    assert File.stat!(path).size < 530_000
    assert File.stat!(path <> ".1").size < 530_000
    assert %LogFile{file: nil} = dir |> Path.join("no/log") |> LogFile.open() |> LogFile.write("x")
  end

  describe "a folder" do
    test "belongs to the process that takes it, until it ends", %{tmp_dir: dir} do
      parent = self()

      pid =
        spawn(fn ->
          send(parent, FolderLock.acquire(dir))
          receive do: (:end -> :ok)
        end)

      assert_receive :ok
      assert {:error, text} = FolderLock.acquire(dir)
      assert text =~ "another gateway in this program"
      ref = Process.monitor(pid)
      send(pid, :end)
      assert_receive {:DOWN, ^ref, _, _, _}
      assert FolderLock.acquire(dir) == :ok
      assert FolderLock.acquire(dir) == :ok
    end

    test "of another running program is refused, of an ended one taken over", %{tmp_dir: dir} do
      port = Port.open({:spawn_executable, "/bin/sh"}, [:binary, args: ["-c", "read -r line"]])
      {:os_pid, pid} = Port.info(port, :os_pid)
      owner = Path.join(dir, "owner")
      File.write!(owner, "#{pid} #{FolderLock.start_time("#{pid}")}\n")
      assert {:error, text} = FolderLock.acquire(dir)
      assert text =~ "process #{pid}"
      # The same number, another life.
      File.write!(owner, "#{pid} 1\n")
      assert FolderLock.acquire(dir) == :ok
      Port.close(port)

      for text <- ["", "x", "999999999 5", "1 2 3"] do
        File.write!(owner, text)
        assert FolderLock.acquire(dir) == :ok
      end
    end

    test "that cannot be made or written is refused with the reason", %{tmp_dir: dir} do
      File.write!(Path.join(dir, "file"), "")
      assert {:error, "cannot make folder" <> _} = FolderLock.acquire(Path.join(dir, "file/x"))
    end
  end

  describe "a program" do
    test "ends on request, and returns its status" do
      port =
        OsProcess.start(
          "/bin/sh",
          ["-c", "trap 'exit 7' TERM; echo ready; while :; do sleep 0.05; done"],
          1_000
        )

      assert_receive {^port, {:data, {:eol, "ready"}}}
      OsProcess.stop(port)
      assert_receive {^port, {:exit_status, 7}}
      assert OsProcess.stop(port) == :ok
    end

    test "has the variables that it is given" do
      port = OsProcess.start("/bin/sh", ["-c", "echo $GIVEN"], 15, [{~c"GIVEN", ~c"this"}])
      assert_receive {^port, {:data, {:eol, "this"}}}
      assert_receive {^port, {:exit_status, 0}}
    end

    test "that ignores TERM is killed" do
      port = OsProcess.start("/bin/sh", ["-c", "trap '' TERM; echo ready; while :; do sleep 0.05; done"])
      assert_receive {^port, {:data, {:eol, "ready"}}}
      OsProcess.stop(port)
      assert_receive {^port, {:exit_status, 137}}
    end

    test "whose pid now belongs to another program is left alone", %{tmp_dir: dir} do
      pid_file = Path.join(dir, "pid")

      for text <- [System.pid(), "0", "-1", "x", "1\n2"] do
        File.write!(pid_file, text)
        refute OsProcess.end_leftover(pid_file, "/no/such.conf")
      end

      refute OsProcess.end_leftover(Path.join(dir, "none"), "/no/such.conf")
    end
  end

  describe "a server that stores nothing is started again" do
    alias Aerie.Fleet.Bridge.NatsServer.RestartPolicy

    test "when its disk has room" do
      restart_policy = RestartPolicy.fault(RestartPolicy.new(), "no space left on device")
      assert {:wait, ^restart_policy} = RestartPolicy.check(restart_policy, 0, {:ok, 100_000})
      assert {:restart, _} = RestartPolicy.check(restart_policy, 0, {:ok, 2_000_000})
      assert {:restart, _} = RestartPolicy.check(restart_policy, 0, :unknown)
      assert {:wait, _} = RestartPolicy.check(RestartPolicy.new(), 0, {:ok, 2_000_000})
    end

    test "with growing pauses where that does not help, and at once after a long time" do
      {times, restart_policy} =
        Enum.flat_map_reduce(0..3_000//1, RestartPolicy.new(), fn second, restart_policy ->
          case RestartPolicy.check(RestartPolicy.fault(restart_policy, "no answer"), second * 1000, :unknown) do
            {:restart, restart_policy} -> {[second], RestartPolicy.started(restart_policy)}
            {:wait, restart_policy} -> {[], restart_policy}
          end
        end)

      assert times == [0, 10, 30, 70, 150, 310, 630, 1230, 1830, 2430]
      later = 100_000_000

      assert {:restart, %{tries: 1, not_before: at}} =
               RestartPolicy.check(RestartPolicy.fault(restart_policy, "again"), later, :unknown)

      assert at == later + 10_000
    end

    test "for the reason that came first" do
      assert %{fault: "full"} =
               RestartPolicy.new() |> RestartPolicy.fault("full") |> RestartPolicy.fault("no answer")

      assert %{fault: nil} = RestartPolicy.new() |> RestartPolicy.fault("full") |> RestartPolicy.started()
    end
  end
end
