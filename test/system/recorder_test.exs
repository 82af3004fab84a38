defmodule Aerie.System.RecorderTest do
  @moduledoc """
  Recordings survive `kill -9` of the gateway, and a full disk.
  """

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  alias Aerie.Fleet.Replay
  alias MavCodec.{Frame, Tlog}

  @moduletag :tmp_dir
  # A small file system that gets really full is mounted in a user namespace.
  @no_namespaces elem(System.cmd("unshare", ["-rm", "true"], stderr_to_stdout: true), 1) != 0 &&
                   "no namespaces here"

  test "a failsafe saves the vehicle's last minutes: the file has the lead-up, and its replay has the failsafe",
       c do
    %{gateway: gateway} =
      start_gateway(c.tmp_dir,
        links: ["udpin:127.0.0.1:0"],
        overrides: %{
          "recorder" => %{"dir" => Path.join(c.tmp_dir, "recordings"), "min_free_mb" => 0, "after_s" => 1}
        }
      )

    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    script = [:ready, :arm, {:takeoff, 5}, {:wait, 300}]

    sim =
      start_supervised!({SimVehicle, firmware: :px4, system: 78, ready_s: 1.0, link: link, script: script})

    mode = fn -> get_in(Store.vehicle(gateway, "VID-078").groups, [:mode, :data, :in_air]) end
    eventually(fn -> Store.vehicle(gateway, "VID-078") && mode.() end, "it flies")
    assert Path.wildcard(Path.join(c.tmp_dir, "recordings/*")) == []

    :ok = SimVehicle.failsafe(sim, :battery_critical)

    [file] =
      eventually(
        fn ->
          files = for %{open: false, file: file} <- MavRouter.Recorder.list(gateway), do: file
          files != [] and Enum.take(files, 1)
        end,
        fn ->
          events = for event <- Aerie.Vehicle.Events.Journal.recent(gateway, "VID-078"), do: event.type
          told = {MavRouter.Recorder.list(gateway), MavRouter.Recorder.status(gateway), events}
          "its last moments are saved: #{inspect(told, limit: 200)}"
        end
      )

    assert Path.basename(file) =~ ~r/\Amain-VID-078-(failsafe|battery\.critical)-/
    assert {:ok, flight} = Replay.run(file)
    types = for event <- flight.events, event.vehicle == "VID-078", do: event.type
    assert ["armed", "takeoff", "failsafe"] -- types == []
  end

  describe "a gateway of its own process" do
    setup %{tmp_dir: folder} do
      recordings = Path.join(folder, "recordings")
      File.mkdir_p!(recordings)
      {link, http} = {free_udp_port(), free_tcp_port()}

      configure = fn more ->
        config_file(folder,
          nats: %{mode: :off},
          sockets: %{enabled: false},
          websocket: %{enabled: false},
          http: %{port: http},
          links: [%{id: "radio", url: "udpin:127.0.0.1:#{link}"}],
          recorder: Map.put(more, :links, "always")
        )
      end

      fly = fn ->
        # What is sent before it is open, nobody hears. On a slow machine it may have been open for a while, and be idle.
        listens = fn ->
          match?(%{"links" => [%{"status" => open}]} when open in ["up", "idle"], api(http, "/api/links"))
        end

        eventually(listens, "the link is open")
        options = [firmware: :px4, ready_s: 1.0, link: "udpout:127.0.0.1:#{link}", rates: %{30 => 200}]
        start_supervised!({SimVehicle, options}, id: :sim)
      end

      %{recordings: recordings, http: http, configure: configure, fly: fly}
    end

    test "killed with -9: its recordings are readable but for the last buffer, and the next start keeps them",
         c do
      config = c.configure.(%{min_free_mb: 0})
      port = open(["--config", config, "--quiet"])
      eventually(fn -> api(c.http, "/api/recorder") end, "it answers", started_by())
      sim = c.fly.()
      written = fn -> api(c.http, "/api/recorder")["recordings"] |> hd() |> Map.fetch!("bytes") end
      eventually(fn -> written.() > 30_000 end, "something is recorded")

      told = written.()
      kill_9(config)
      # Before anything else: nobody hears what it sends from here on.
      sent = SimVehicle.stats(sim).sent
      assert await_exit(port) != 0
      stop_supervised!(:sim)

      assert [file] = Path.wildcard(c.recordings <> "/*.tlog")
      items = file |> Tlog.Reader.stream!() |> Enum.to_list()
      {frames, damage} = Enum.split_with(items, &is_struct(&1, Frame))
      assert length(damage) <= 1
      assert Enum.all?(damage, &match?(%Tlog.Damage{kind: :cut_off}, &1))
      # Everything that the status reported as written is in the file.
      assert File.stat!(file).size >= told

      heard = Enum.filter(frames, &(&1.system == 1))
      assert consecutive?(heard)
      # The buffer has 64 KiB; as much again may have been on the way.
      lost = sent - length(heard)
      assert lost * div(File.stat!(file).size, length(frames)) <= 2 * 65_536
      assert {:ok, %{summary: %{vehicles: ["VID-001"]}}} = Replay.run(file)

      port = open(["--config", config, "--quiet"])
      eventually(fn -> api(c.http, "/api/recorder") end, "the next life answers")
      c.fly.()

      eventually(
        fn -> match?([_, _], Path.wildcard(c.recordings <> "/*.tlog")) end,
        "it has a file of its own"
      )

      assert items == file |> Tlog.Reader.stream!() |> Enum.to_list()
      %{"files" => files} = api(c.http, "/api/recorder")
      assert Path.basename(file) in Enum.map(files, & &1["name"])
      kill_9(config)
      await_exit(port)
    end

    @tag skip: @no_namespaces
    test "a really full disk costs records but no frame, and is reported", c do
      config = c.configure.(%{min_free_mb: 0})
      port = open(["--config", config, "--quiet"], on_disk_of(c.recordings, "64k"))
      eventually(fn -> api(c.http, "/api/recorder") end, "it answers", started_by())
      sim = c.fly.()

      recorder =
        eventually(
          fn -> with %{"paused" => 1} = told <- api(c.http, "/api/recorder"), do: told, else: (_ -> nil) end,
          "the disk is full"
        )

      assert recorder["error"]["reason"] =~ "no space left on device"
      eventually(fn -> api(c.http, "/api/recorder")["dropped"] > 100 end, "records are dropped")
      assert %{"recorder" => %{"paused" => 1}} = api(c.http, "/api/status")

      SimVehicle.fault(sim, :freeze, true)
      %{sent: sent} = SimVehicle.stats(sim)
      counters = fn -> with %{"links" => [link]} <- api(c.http, "/api/links"), do: link["counters"] end
      eventually(fn -> counters.()["frames_in"] == sent end, "all of #{sent} frames came through")
      assert %{"lost" => 0, "overload" => 0} = counters.()

      # The records from before the disk was full are readable.
      [file | _] = Path.wildcard("/proc/#{vm_pid(config)}/root#{c.recordings}/*.tlog")
      assert {:ok, %{summary: %{frames: frames, damaged_parts: parts}}} = Replay.run(file)
      assert frames > 100 and parts <= 1
      kill_9(config)
      await_exit(port)
    end

    @tag skip: @no_namespaces
    test "the oldest recordings are removed to keep a small disk free", c do
      config = c.configure.(%{min_free_mb: 0.02, max_file_mb: 0.01})
      port = open(["--config", config, "--quiet"], on_disk_of(c.recordings, "64k"))
      eventually(fn -> api(c.http, "/api/recorder") end, "it answers", started_by())
      c.fly.()

      eventually(
        fn ->
          with [%{"bytes" => bytes}] <- api(c.http, "/api/recorder")["recordings"], do: bytes > 80_000
        end,
        "more is recorded than the disk has"
      )

      recorder = api(c.http, "/api/recorder")
      assert recorder["files"] |> Enum.map(& &1["bytes"]) |> Enum.sum() < 64_000
      kill_9(config)
      await_exit(port)
    end
  end

  defp on_disk_of(dir, size) do
    script = "mount -t tmpfs -o size=\"$1\" tmpfs \"$2\" && shift 2 && exec \"$@\""
    ["unshare", "-rm", "sh", "-c", script, "sh", size, dir]
  end

  defp consecutive?(frames) do
    frames
    |> Enum.map(& &1.seq)
    |> Enum.chunk_every(2, 1, :discard)
    |> Enum.all?(fn [a, b] -> b == rem(a + 1, 256) end)
  end
end
