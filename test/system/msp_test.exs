defmodule Aerie.System.MspTest do
  @moduledoc """
  Simulated Betaflight and iNav over MSP: the same state, events and commands as of MAVLink vehicles, and a ground station sees them,
  too. YAMSPy is the peer of the simulators.
  """
  use Aerie.SystemCase, async: true

  import Aerie.PeerCase, only: [findings: 1, start_peer: 2]

  alias Aerie.Control.{Commands, Missions, Params}
  alias Aerie.Fleet.Shadow
  alias Protocols.Mission.File.QgcPlan
  alias Aerie.HubServer
  alias SimVehicle.Msp

  @moduletag :tmp_dir
  @moduletag :capture_log

  @low [1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000]
  @armed [1500, 1500, 1000, 1500, 1900, 1000, 1000, 1000]
  @climb [1500, 1500, 1900, 1500, 1900, 1900, 1000, 1000]
  @vehicles %{betaflight: 7, inav: 8}

  defp fly(dir, firmwares, overrides \\ %{}, options \\ []) do
    sims =
      Map.new(
        firmwares,
        &{&1, start_supervised!({Msp, [firmware: &1, uid: @vehicles[&1]] ++ options}, id: &1)}
      )

    links = for {firmware, sim} <- sims, do: "msp:tcp:127.0.0.1:#{Msp.port(sim)}?sysid=#{@vehicles[firmware]}"

    %{gateway: gateway} =
      start_gateway(dir, links: links, overrides: Map.merge(%{"timeouts" => patient()}, overrides))

    # Without its channels one that has MSP as its receiver is not ready.
    for firmware <- firmwares do
      known = fn -> data(gateway, :health, key(firmware)) end

      eventually(
        fn -> known.()[:ready_to_arm] || (options[:rx_msp] && known.()) end,
        "#{firmware} could be armed"
      )
    end

    %{gateway: gateway, sims: sims, conn: nats_client(gateway)}
  end

  defp key(firmware), do: {"main", @vehicles[firmware]}
  defp name(firmware), do: "VID-00#{@vehicles[firmware]}"

  defp events(c, firmware) do
    for %{"vehicle" => vehicle} = event <- stream_events(c.conn), vehicle == name(firmware), do: event
  end

  defp event(c, firmware, type, test \\ fn _event -> true end) do
    eventually(
      fn -> Enum.find(events(c, firmware), &(&1["type"] == type and test.(&1["data"]))) end,
      "the event #{type} of #{firmware}"
    )
  end

  @admin %{name: "ada", role: :admin, permissions: []}
  @commander %{name: "cory", role: :admin, permissions: [:receiver, :motors]}

  defp submit(c, firmware, type, params \\ %{}, source \\ nil) do
    command = [vehicle: name(firmware), type: type, params: params, deadline: System.os_time(:second) + 60]
    {:ok, result} = Commands.submit(c.gateway, if(source, do: [as: source] ++ command, else: command))
    result
  end

  # In its first seconds a vehicle takes no such command, as it is not known yet whose firmware it is.
  defp command(c, firmware, type, params \\ %{}) do
    eventually(
      fn ->
        result = submit(c, firmware, type, params, @commander)
        if to_string(result.reason) =~ "TEMPORARILY_REJECTED", do: nil, else: result
      end,
      "#{type} is taken or refused"
    )
  end

  test "a flight: armed, the mode by its name, in the air, height, landed and disarmed", %{tmp_dir: dir} do
    c = fly(dir, [:betaflight, :inav])

    for {firmware, sim} <- c.sims do
      assert %{autopilot: ^firmware, vehicle_type: "copter"} =
               Aerie.Base.Store.vehicle(c.gateway, key(firmware))

      assert %{mode: "ACRO", armed: false, in_air: false} = data(c.gateway, :mode, key(firmware))
      :ok = Msp.sticks(sim, @armed)
      event(c, firmware, "armed")
      :ok = Msp.sticks(sim, @climb)
      event(c, firmware, "mode_change", &(&1["to"] == "ANGLE" or &1["mode"] == "ANGLE"))
      event(c, firmware, "takeoff")

      eventually(
        fn -> (data(c.gateway, :position, key(firmware))[:alt_rel] || 0) > 5 end,
        "#{firmware} is above 5 m"
      )

      assert_in_delta data(c.gateway, :position, key(firmware)).alt_msl,
                      488 + data(c.gateway, :position, key(firmware)).alt_rel,
                      3

      assert %{voltage: volts, current: 12.0, charge_state: "OK"} = data(c.gateway, :battery, key(firmware))
      assert volts > 14
      :ok = Msp.sticks(sim, List.replace_at(@climb, 2, 1000))
      event(c, firmware, "landed")
      :ok = Msp.sticks(sim, @low)
      event(c, firmware, "disarmed")
    end
  end

  @flight ~w(armed mode_change takeoff landed disarmed)

  test "the line is recorded: done again, it gives the same bytes, and so the same events, and it can be read",
       %{
         tmp_dir: dir
       } do
    recorder = %{"dir" => Path.join(dir, "recordings"), "links" => "always", "min_free_mb" => 0}
    c = fly(dir, [:betaflight, :inav], %{"recorder" => recorder})
    :ok = Aerie.Base.PubSub.subscribe(c.gateway, :events)

    for {firmware, name, value} <- [
          {:betaflight, "vbat_warning_cell_voltage", 360},
          {:inav, "nav_rth_linear_descent_start_distance", 250}
        ] do
      sim = c.sims[firmware]
      [link] = Aerie.Base.Store.vehicle(c.gateway, key(firmware)).links
      assert {:ok, %{status: :completed}} = Params.set(c.gateway, name(firmware), name, value)
      :ok = Msp.sticks(sim, @armed)
      event(c, firmware, "armed")
      :ok = Msp.sticks(sim, @climb)
      event(c, firmware, "takeoff")
      :ok = Msp.sticks(sim, List.replace_at(@climb, 2, 1000))
      event(c, firmware, "landed")
      :ok = Msp.sticks(sim, @low)
      event(c, firmware, "disarmed")
      assert :ok = MavRouter.Recorder.stop(c.gateway, {:link, link})

      assert %{dropped: 0, errors: 0} = MavRouter.Recorder.status(c.gateway, {:link, link})
      [file] = dir |> Path.join("recordings/main-#{link}-*.tlog") |> Path.wildcard()

      listed =
        ExUnit.CaptureIO.capture_io(fn ->
          {result, compared} = Aerie.StandardError.capture(fn -> Aerie.CLI.call(["msp", file], dir) end)
          assert result == {0, ""}
          assert compared =~ ~r/done again: the same \d{3,} writes and \d{3,} MAVLink frames/
        end)

      assert listed =~ ~r/ > (STATUS_EX|MSP2_INAV_STATUS)\n/
      assert listed =~ ~r/ MAVLink PARAM_SET .*param_value=#{value}/

      assert {:ok, flight} = Aerie.Fleet.Replay.run(file)

      # The other vehicle's frames are on their way to this one, too. Their numbers count what a replay does not know (README of Aerie.Fleet.Replay).
      flown = fn events ->
        for e <- events, e.vehicle == name(firmware), e.type in @flight, do: {e.type, e.time, e.data}
      end

      live = flown.(told())
      assert flown.(flight.events) == live
      assert length(live) >= 5
    end
  end

  defp told do
    receive do
      {:fleet, :events, event} -> [event | told()]
    after
      0 -> []
    end
  end

  test "the receiver is lost: what keeps it from being armed, and a failsafe with its reason and its end", %{
    tmp_dir: dir
  } do
    c = fly(dir, [:betaflight])
    sim = c.sims.betaflight
    :ok = Msp.lose_rc(sim, true)

    checks = fn ->
      for check <- data(c.gateway, :health, key(:betaflight))[:arming_checks] || [], do: check.name
    end

    eventually(fn -> "RX_FAILSAFE" in checks.() end, "the reason is shown")
    :ok = Msp.lose_rc(sim, false)
    eventually(fn -> checks.() == [] end, "nothing is in the way")

    :ok = Msp.sticks(sim, @armed)
    event(c, :betaflight, "armed")
    :ok = Msp.lose_rc(sim, true)
    assert %{"data" => %{"reason" => "rc"}} = event(c, :betaflight, "failsafe", &(&1["active"] != false))
    event(c, :betaflight, "disarmed")
    :ok = Msp.lose_rc(sim, false)
    :ok = Msp.sticks(sim, @low)
    event(c, :betaflight, "failsafe.cleared")
  end

  test "commands: what the firmware can is done, what it cannot is a gap, what it should not is refused", %{
    tmp_dir: dir
  } do
    c = fly(dir, [:betaflight, :inav])

    for {firmware, sim} <- c.sims do
      # Its pilot's transmitter is in charge, whoever asks.
      assert %{status: :rejected, reason: reason} = command(c, firmware, "arm")
      assert reason =~ "a transmitter is in charge"

      assert %{status: :denied, details: %{"rule" => "role"}, reason: reason} =
               submit(c, firmware, "arm", %{}, @admin)

      assert reason =~ "arm needs the permission receiver, which no role includes"

      assert %{status: :denied, reason: reason} =
               submit(c, firmware, "motor_test", %{motor: 1, throttle: 0.1, duration: 1}, @admin)

      assert reason =~ "motor_test needs the permission motors"

      assert %{status: :rejected, reason: reason} =
               submit(c, firmware, "land")

      assert reason =~ "no such command over MSP"
      assert %{status: :accepted} = submit(c, firmware, "calibrate", %{sensor: "accelerometer"})
      assert {:calibrating, 205} in Msp.state(sim).events
      assert %{status: :accepted} = submit(c, firmware, "save_params")
      assert :stored in Msp.state(sim).events

      Msp.await(sim, &(Msp.Firmware.arming_flags(&1) == 0))
      :ok = Msp.sticks(sim, @armed)
      event(c, firmware, "armed")
      # Betaflight would do it.
      assert %{status: :denied, reason: reason} = submit(c, firmware, "reboot")
      assert reason =~ "only while the vehicle is disarmed"
      assert Msp.state(sim).boots == 1
      :ok = Msp.sticks(sim, @low)
      event(c, firmware, "disarmed")
      assert %{status: :completed} = submit(c, firmware, "reboot")
      assert Msp.state(sim).boots == 2
      event(c, firmware, "reboot")
    end
  end

  test "Betaflight from API 1.48 on: its settings by name, in the list, from a file of its command line, and described",
       %{
         tmp_dir: dir
       } do
    c = fly(dir, [:betaflight], %{}, api: {1, 48})
    by = [as: %{name: "crew", role: :admin, permissions: []}]
    {:ok, table} = Params.list(c.gateway, "VID-007")
    assert Params.Table.count(table) > 380
    assert %{"acc_lpf_hz" => %{value: 25}, "vbat_warning_cell_voltage" => %{value: 350}} = table.params
    {:ok, described} = Params.metadata(c.gateway, "VID-007")
    assert %{min: 0, max: 500, default: 25} = described["acc_lpf_hz"]

    file =
      "# diff all\n# Betaflight / STM32F405 (S405) 2026.6.1\nset acc_lpf_hz = 40\nset blackbox_mode = ALWAYS\nset p_roll = 47\n"

    assert {:ok, %{status: :completed}} = Params.load(c.gateway, "VID-007", file, by)
    assert %{"acc_lpf_hz" => 40, "blackbox_mode" => 2} = Msp.state(c.sims.betaflight).settings
    assert {:ok, %{value: 47}} = Params.get(c.gateway, "VID-007", "p_roll")

    assert {:ok, %{status: :denied}} =
             Params.set(c.gateway, "VID-007", "runaway_takeoff_prevention", 0,
               as: %{name: "pip", role: :operator, permissions: [:maintain]}
             )

    assert %{status: :accepted} = submit(c, :betaflight, "save_params", %{}, @admin)
    assert %{settings: %{"acc_lpf_hz" => 40}} = Msp.state(c.sims.betaflight).stored
  end

  test "parameters: by their whole names, with ranges and words, set, refused, stored", %{tmp_dir: dir} do
    c = fly(dir, [:betaflight, :inav])
    by = [as: %{name: "crew", role: :admin, permissions: []}]

    for {firmware, name, value, wrong} <- [
          {:betaflight, "vbat_warning_cell_voltage", 360, 600},
          {:inav, "nav_rth_linear_descent_start_distance", 250, 20_000}
        ] do
      vehicle = name(firmware)
      {:ok, table} = Params.list(c.gateway, vehicle)
      assert is_map_key(table.params, name) and Params.Table.count(table) > 180
      {:ok, described} = Params.metadata(c.gateway, vehicle)
      assert %{min: low, max: high} = described[name]
      assert value in low..high and wrong not in low..high

      assert {:ok, %{status: :completed, details: %{"name" => ^name}}} =
               Params.set(c.gateway, vehicle, name, value, by)

      assert {:ok, %{name: ^name, value: ^value}} = Params.get(c.gateway, vehicle, name)
      assert {:ok, %{status: :rejected, reason: reason}} = Params.set(c.gateway, vehicle, name, wrong, by)
      assert reason =~ "OUT_OF_RANGE"
      {:ok, %{status: :completed}} = Params.load(c.gateway, vehicle, "#{name},#{value + 1}\n", by)
      assert {:ok, %{value: after_load}} = Params.get(c.gateway, vehicle, name)
      assert after_load == value + 1
      # As the configurators keep them: written, changed in one value, and read again.
      {:ok, text} = Params.save(c.gateway, vehicle, :txt)
      assert text =~ "set #{name} = #{value + 1}\n"
      assert text =~ %{betaflight: "# Betaflight 4.5: save", inav: "# iNav 9.0: save"}[firmware]
      # The command line takes only words there.
      assert text =~ ~r/^set failsafe_procedure = [A-Z-]+$/m
      assert text =~ ~r/^set serialrx_provider = [A-Z0-9-]+$/m
      back = String.replace(text, "set #{name} = #{value + 1}\n", "set #{name} = #{value}\n")
      assert {:ok, %{status: :completed, details: %{"set" => 1}}} = Params.load(c.gateway, vehicle, back, by)
      assert {:ok, %{value: ^value}} = Params.get(c.gateway, vehicle, name)
      assert %{status: :accepted} = submit(c, firmware, "save_params")
      stored = Msp.state(c.sims[firmware])
      assert stored.stored == Map.take(stored, [:blocks, :settings])
    end
  end

  test "Betaflight 4.5 has its own ranges, and a rescue without throttle is refused", %{tmp_dir: dir} do
    c = fly(dir, [:betaflight])
    by = [as: %{name: "crew", role: :admin, permissions: []}]
    vehicle = name(:betaflight)
    {:ok, described} = Params.metadata(c.gateway, vehicle)
    assert %{min: 1000, max: 2000, default: nil} = described["gps_rescue_throttle_hover"]
    assert "MAVLINK" not in Enum.map(described["serialrx_provider"].values, & &1.text)
    refute is_map_key(described, "ap_hover_throttle")
    before = Msp.state(c.sims.betaflight).blocks

    for {name, value} <- [{"gps_rescue_throttle_hover", 0}, {"gps_rescue_max_angle", 70}] do
      assert {:ok, %{status: :rejected, reason: reason}} = Params.set(c.gateway, vehicle, name, value, by)
      assert reason =~ "OUT_OF_RANGE"
    end

    assert Msp.state(c.sims.betaflight).blocks == before
  end

  test "where MSP is the receiver: armed, flown by sticks, returned by its mode, disarmed, all in its ledger",
       %{tmp_dir: dir} do
    c = fly(dir, [:betaflight, :inav], %{}, rx_msp: true)

    for {firmware, sim} <- c.sims do
      Msp.await(sim, &(&1.now > 6_000_000))
      assert %{status: :completed} = command(c, firmware, "arm")
      # Each is in force for longer than the next one takes.
      climb = fn throttle ->
        submit(c, firmware, "manual_control", %{throttle: throttle, hold: 10.0}, @commander)
      end

      up = Task.async(fn -> climb.(0.8) end)

      eventually(
        fn -> (data(c.gateway, :position, key(firmware))[:alt_rel] || 0) > 2 end,
        "#{firmware} climbs"
      )

      mode = if firmware == :inav, do: "NAV RTH", else: "GPS RESCUE"
      assert %{status: :completed} = submit(c, firmware, "rtl", %{}, @commander)
      assert data(c.gateway, :mode, key(firmware)).mode == mode
      assert %{status: :accepted, reason: reason} = Task.await(up, Aerie.Patience.ms())
      assert reason == nil or reason =~ "a text says"
      event(c, firmware, "armed")
      # Nobody steers any more, in the air: its own failsafe.
      event(c, firmware, "failsafe", &(&1["active"] != false))
    end
  end

  test "a rescue that is flown as a plan of the autopilot is a return", %{tmp_dir: dir} do
    c = fly(dir, [:betaflight], %{}, rx_msp: true, api: {1, 48}, rescue_plan: true)
    Msp.await(c.sims.betaflight, &(&1.now > 6_000_000))
    assert %{status: :completed} = command(c, :betaflight, "arm")
    assert %{status: :completed, reason: nil} = submit(c, :betaflight, "rtl", %{}, @commander)
    assert data(c.gateway, :mode, key(:betaflight)).mode == "AUTOPILOT"
  end

  @mwp """
  <mission>
    <missionitem action="WAYPOINT" lat="47.3977418" lon="8.5455939" alt="35"/>
    <missionitem action="WAYPOINT" lat="47.3980418" lon="8.5455939" alt="40" parameter1="750"/>
    <missionitem action="POSHOLD_TIME" lat="47.3980418" lon="8.5459939" alt="40" parameter1="20" parameter2="750"/>
    <missionitem action="JUMP" parameter1="1" parameter2="3"/>
    <missionitem action="RTH" parameter1="1" flag="165"/>
  </mission>
  """

  test "one steers: neither another key nor another ground station with the same ids", %{tmp_dir: dir} do
    alias MavCodec.Messages, as: M

    c =
      fly(
        dir,
        [:betaflight],
        %{
          "clients" => [%{"id" => "gcs", "url" => "tcpin:127.0.0.1:0"}],
          "policy" => %{"clients" => [%{"id" => "gcs", "role" => "operator", "permissions" => ["receiver"]}]}
        },
        rx_msp: true
      )

    port = eventually(fn -> MavRouter.Link.snapshot(c.gateway, "gcs").port end, "the client's port is open")

    [first, second] =
      for _n <- 1..2 do
        {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
        socket
      end

    say = fn socket, message ->
      :ok = :gen_tcp.send(socket, MavCodec.encode(message, system: 255, component: 190))
    end

    sticks = &%M.ManualControl{target: 7, x: 0, y: 0, z: &1, r: 0}
    arm = %M.CommandLong{target_system: 7, target_component: 1, command: 400, param1: 1.0}
    armed = fn -> Msp.state(c.sims.betaflight).armed end

    eventually(
      fn ->
        :ok = say.(first, arm)
        armed.()
      end,
      "it is armed"
    )

    throttle = fn -> Enum.at(Msp.state(c.sims.betaflight).channels, 2) end
    other = %{@commander | name: "carl"}

    eventually(
      fn ->
        say.(first, sticks.(100))
        say.(second, sticks.(80))
        refute throttle.() == 1080
        throttle.() == 1100
      end,
      "the first one's sticks arrive"
    )

    # While it goes on, nobody else steers, by whichever way. All throttles are low: a busy machine may hold the sticks
    # up for so long that they lapse, and a vehicle that flies is not disarmed.
    steering =
      Task.async(fn ->
        Stream.interval(20) |> Enum.each(fn _n -> say.(first, sticks.(100)) end)
      end)

    assert %{status: :denied, reason: reason} =
             submit(c, :betaflight, "manual_control", %{throttle: 0.9}, other)

    assert reason =~ ~r/gcs .*127.0.0.1:\d+.* steers it/
    say.(second, sticks.(80))

    told = fn frames ->
      Enum.any?(frames, fn frame ->
        match?({:ok, %M.Statustext{text: "refused: manual_control: gcs" <> _}}, MavCodec.decode(frame))
      end)
    end

    heard(second, MavCodec.Parser.new(), told, [])
    assert throttle.() == 1100
    # But may disarm it. On a busy machine its height may be so old that it is taken for flying.
    eventually(
      fn -> submit(c, :betaflight, "disarm", %{}, other).status == :completed end,
      "somebody else disarms it"
    )

    Task.shutdown(steering, :brutal_kill)
    refute armed.()
  end

  test "iNav's mission: from mwp's file to the vehicle and back, stored, and there after a restart", %{
    tmp_dir: dir
  } do
    c = fly(dir, [:inav])
    {:ok, plan} = Missions.import(@mwp, :any)
    by = [as: %{name: "crew", role: :admin, permissions: []}]

    assert {:ok, %{status: :completed, details: %{"on_board" => "new"}}} =
             Missions.upload(c.gateway, name(:inav), :mission, plan, by)

    assert length(Msp.state(c.sims.inav).mission.list) == 5
    {:ok, %{plan: read}} = Missions.download(c.gateway, name(:inav), :mission)
    assert Missions.export(read, :mission) == Missions.export(plan, :mission)
    assert {:ok, %{plan: %{fence: []}}} = Missions.download(c.gateway, name(:inav), :fence)

    assert {:ok, %{status: :rejected, reason: reason}} = Missions.clear(c.gateway, name(:inav), :mission, by)
    assert reason =~ "MSP has no message that removes iNav's mission"

    # Taking off is not an item that it has: its words say so.
    odd = %{plan | items: [%{hd(plan.items) | command: 22}]}

    assert {:ok, %{status: :rejected, reason: reason}} =
             Missions.upload(c.gateway, name(:inav), :mission, odd, by)

    assert reason =~ "takes off by hand"

    assert %{status: :accepted} = submit(c, :inav, "save_params", %{what: "mission"})
    assert :mission_stored in Msp.state(c.sims.inav).events
    # Where it is to fly, once its pilot lets the ground say so.
    place = %{lat: 47.3982, lon: 8.5461, altitude: 30, altitude_reference: "home"}
    :ok = Msp.sticks(c.sims.inav, @armed)
    event(c, :inav, "armed")
    assert %{status: :rejected, reason: reason} = submit(c, :inav, "goto", place)
    assert reason =~ "GCS NAV"
    :ok = Msp.sticks(c.sims.inav, [1500, 1500, 1000, 1500, 1900, 1000, 1300, 1000, 1900])
    event(c, :inav, "mode_change", &(&1["to"] == "NAV POSHOLD" or &1["mode"] == "NAV POSHOLD"))
    assert %{status: :accepted} = submit(c, :inav, "goto", place)
    assert <<lat::32-little, _lon::binary>> = Msp.state(c.sims.inav).mission.desired
    assert_in_delta lat, 473_982_000, 10
    :ok = Msp.sticks(c.sims.inav, @low)
    c = fly(Path.join(dir, "betaflight"), [:betaflight])
    # Nothing is sent of what the firmware lacks, to be written or read.
    assert {:ok, %{status: :rejected, reason: "Betaflight has no missions" <> _ = reason}} =
             Missions.upload(c.gateway, name(:betaflight), :mission, plan, by)

    assert {:ok, %{status: :rejected, reason: ^reason}} =
             Missions.clear(c.gateway, name(:betaflight), :fence, Keyword.put(by, :as, @admin))

    assert {:error, %{status: :rejected, reason: ^reason}} =
             Missions.download(c.gateway, name(:betaflight), :rally)
  end

  test "a ground station sees it, with its modes by name",
       %{tmp_dir: dir} do
    c = fly(dir, [:betaflight], %{"clients" => [%{"id" => "gcs", "url" => "tcpin:127.0.0.1:0"}]})
    port = eventually(fn -> MavRouter.Link.snapshot(c.gateway, "gcs").port end, "the endpoint is open")
    found = findings(start_peer("pymavlink_listener.py", ["tcp:127.0.0.1:#{port}", @vehicles.betaflight]))

    assert %{
             "type" => "2",
             "autopilot" => "0",
             "mode" => "ACRO",
             "pitch" => "0",
             "satellites" => "14",
             "armed" => "False"
           } = found

    assert_in_delta String.to_float(found["volts"]), 16.8, 0.3
  end

  test "the shadow: parameters by their whole names, iNav's mission, a mode that its pilot has, and held while it is armed",
       %{tmp_dir: dir} do
    shadow = %{"shadow" => %{"dir" => Path.join(dir, "shadow"), "hold_s" => 1, "lease_s" => 2}}
    c = fly(dir, [:betaflight, :inav], shadow)
    {:ok, plan} = Missions.import(@mwp, :any)
    {:ok, hash} = Shadow.put_plan(c.gateway, QgcPlan.write(plan))

    for {firmware, param, value, more} <- [
          {:betaflight, "vbat_warning_cell_voltage", 361, %{}},
          {:inav, "nav_rth_linear_descent_start_distance", 251, %{"mission" => %{"plan" => hash}}}
        ] do
      vehicle = name(firmware)
      desire = fn desired -> {:ok, _done} = Shadow.update(c.gateway, vehicle, %{"desired" => desired}) end
      report = fn path -> Shadow.report(c.gateway, vehicle)[path] end

      standing = fn path, state ->
        eventually(
          fn -> match?(%{state: ^state}, report.(path)) end,
          fn -> "#{vehicle} #{path} is #{state}; it is #{inspect(report.(path))}" end
        )
      end

      desire.(Map.merge(%{"params" => %{param => value}, "mode" => "ACRO"}, more))

      for path <- ["params.#{param}", "mode"] ++ if(more == %{}, do: [], else: ["mission.plan"]),
          do: standing.(path, :converged)

      assert {:ok, %{value: ^value}} = Params.get(c.gateway, vehicle, param)
      # Nothing is set while it is armed; afterwards it is.
      :ok = Msp.sticks(c.sims[firmware], @armed)
      event(c, firmware, "armed")
      desire.(%{"params" => %{param => value + 1}})
      eventually(fn -> report.("params.#{param}")[:state] not in [:converged, nil] end, "it differs")
      assert {:ok, %{value: ^value}} = Params.get(c.gateway, vehicle, param)
      :ok = Msp.sticks(c.sims[firmware], @low)
      event(c, firmware, "disarmed")
      standing.("params.#{param}", :converged)
    end

    assert length(Msp.state(c.sims.inav).mission.list) == 5
  end

  defmodule Cable do
    @moduledoc "A serial cable between a pseudo terminal and a simulated flight controller's port."
    use GenServer

    def start_link(options), do: GenServer.start_link(__MODULE__, options)
    def peer(cable), do: GenServer.call(cable, :peer, Aerie.Patience.ms())

    @impl GenServer
    def init(options) do
      {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, options[:port], [:binary, active: true])
      {:ok, peer} = GenServer.start_link(Aerie.SerialPeer, to: self(), baud: 115_200)
      {:ok, %{socket: socket, peer: peer}}
    end

    @impl GenServer
    def handle_call(:peer, _from, state), do: {:reply, state.peer, state}

    @impl GenServer
    def handle_info({:tcp, _socket, bytes}, state) do
      :ok = Aerie.SerialPeer.say(state.peer, bytes)
      {:noreply, state}
    end

    def handle_info({:heard, _peer, bytes}, state) do
      :ok = :gen_tcp.send(state.socket, bytes)
      {:noreply, state}
    end
  end

  test "at a serial port: the same, and no motor turns on when the gateway ends in order", %{tmp_dir: dir} do
    if Aerie.SerialPeer.build() do
      sim = start_supervised!({Msp, firmware: :betaflight, uid: 7})
      cable = start_supervised!({Cable, port: Msp.port(sim)})
      left_turning(dir, sim, "msp:#{Aerie.SerialPeer.path(Cable.peer(cable))},115200?sysid=7")
    else
      IO.puts(:stderr, "no C compiler: no serial cable")
    end
  end

  test "msp:auto finds it among the ports, and writes nothing to the one that speaks MAVLink", %{tmp_dir: dir} do
    if Aerie.SerialPeer.build() do
      heartbeat =
        MavCodec.encode(%MavCodec.Messages.Heartbeat{type: 2, autopilot: 3}, system: 1, component: 1)

      mavlink = Aerie.SerialPeer.start(every: 200, says: fn _ -> heartbeat end)
      sim = start_supervised!({Msp, firmware: :inav, uid: 7})
      cable = start_supervised!({Cable, port: Msp.port(sim)})
      [first, second] = Enum.map([mavlink, Cable.peer(cable)], &Aerie.SerialPeer.path/1)
      link = "msp:auto?ports=#{first},#{second}&only=true&sysid=7"
      %{gateway: gateway} = start_gateway(dir, links: [link], overrides: %{"timeouts" => patient()})
      eventually(fn -> data(gateway, :health, key(:betaflight))[:ready_to_arm] end, "it could be armed")

      assert %{local: ^second, finding: %{evidence: "answers as iNav", baud: 115_200}} =
               Aerie.Base.Store.link(gateway, "link-1")

      refute_received {:heard, ^mavlink, _anything}
    else
      IO.puts(:stderr, "no C compiler: no serial cable")
    end
  end

  test "over TCP no motor turns on either when the gateway ends in order", %{tmp_dir: dir} do
    sim = start_supervised!({Msp, firmware: :betaflight, uid: 7})
    left_turning(dir, sim, "msp:tcp:127.0.0.1:#{Msp.port(sim)}?sysid=7")
  end

  defp left_turning(dir, sim, link) do
    started = start_gateway(dir, links: [link], overrides: %{"timeouts" => patient()})
    gateway = started.gateway
    eventually(fn -> data(gateway, :health, key(:betaflight))[:ready_to_arm] end, "it could be armed")
    assert %{voltage: volts} = data(gateway, :battery, key(:betaflight))
    assert volts > 14
    c = %{gateway: gateway}

    turn =
      Task.async(fn -> command(c, :betaflight, "motor_test", %{motor: 1, throttle: 0.2, duration: 3}) end)

    motors = fn fc -> for(<<us::16-little <- fc.blocks[104]>>, do: us) end
    Msp.await(sim, &(Enum.max(motors.(&1)) == 1200))
    assert %{status: :accepted} = Task.await(turn, Aerie.Patience.ms())
    stop_gateway(started)
    Msp.await(sim, &(Enum.max(motors.(&1)) == 1000))
  end

  # `spoof.py`: one heartbeat, and the vehicle was of an unknown firmware for good, which needed neither permission.
  test "what somebody says in its name, by another link, does not make it another vehicle", %{tmp_dir: dir} do
    alias MavCodec.Messages, as: M
    sim = start_supervised!({Msp, firmware: :betaflight, uid: 7, rx_msp: true})
    links = ["msp:tcp:127.0.0.1:#{Msp.port(sim)}?sysid=7", "udpin:127.0.0.1:0"]
    %{gateway: gateway} = start_gateway(dir, links: links, overrides: %{"timeouts" => patient()})
    vehicle = fn -> Aerie.Base.Store.vehicle(gateway, key(:betaflight)) end
    eventually(fn -> match?(%{autopilot: :betaflight}, vehicle.()) end, "it is known")
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    port = link_port(gateway, "link-2")

    for message <- [
          %M.Heartbeat{type: 2, autopilot: 3, system_status: 3},
          %M.Heartbeat{type: 1, autopilot: 12, system_status: 3},
          %M.ComponentInformationBasic{vendor_name: "iNav"}
        ] do
      since = vehicle.().last_heard

      eventually(
        fn ->
          :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, MavCodec.encode(message, system: 7, component: 1))
          assert %{autopilot: :betaflight, vehicle_type: "copter"} = vehicle.()
          vehicle.().last_heard > since + 1_500_000
        end,
        "it went on saying what it is"
      )
    end

    c = %{gateway: gateway}
    operator = %{name: "olga", role: :operator, permissions: []}

    assert %{status: :denied, reason: "arm needs the permission receiver" <> _} =
             submit(c, :betaflight, "arm", %{}, operator)

    assert %{status: :denied, reason: "motor_test needs the permission" <> _} =
             submit(c, :betaflight, "motor_test", %{motor: 1, throttle: 0.1, duration: 1}, operator)

    assert %{status: :completed} = submit(c, :betaflight, "disarm", %{}, @commander)
  end

  test "a network of its own keeps it from ground stations that have another one", %{tmp_dir: dir} do
    links =
      for {network, id} <- [{"msp", 7}, {"main", 8}] do
        sim = start_supervised!({Msp, firmware: :betaflight, uid: id}, id: id)
        %{"url" => "msp:tcp:127.0.0.1:#{Msp.port(sim)}?sysid=#{id}", "network" => network}
      end

    %{gateway: gateway} =
      start_gateway(dir,
        links: [],
        overrides: %{
          "timeouts" => patient(),
          "links" => links,
          "clients" => [
            %{"id" => "all", "url" => "tcpin:127.0.0.1:0"},
            %{"id" => "main", "url" => "tcpin:127.0.0.1:0", "networks" => ["main"]}
          ]
        }
      )

    [all, main] =
      for id <- ["all", "main"] do
        port = eventually(fn -> MavRouter.Link.snapshot(gateway, id).port end, id)
        {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
        socket
      end

    both = heard(all, MavCodec.Parser.new(), &systems?(&1, [7, 8]), [])
    assert Enum.any?(both, &(&1.system == 7)) and Enum.any?(both, &(&1.system == 8))
    own = heard(main, MavCodec.Parser.new(), fn frames -> Enum.count(frames, &(&1.system == 8)) > 50 end, [])
    refute Enum.any?(own, &(&1.system == 7))
  end

  defp systems?(frames, ids), do: Enum.all?(ids, fn id -> Enum.any?(frames, &(&1.system == id)) end)

  defp heard(socket, parser, enough?, frames) do
    {:ok, bytes} = :gen_tcp.recv(socket, 0, Aerie.Patience.ms())
    {more, parser} = MavCodec.Parser.push(parser, bytes, 0)
    frames = frames ++ more
    if enough?.(frames), do: frames, else: heard(socket, parser, enough?, frames)
  end

  test "its line breaks: it is stale, and comes back with the same name", %{tmp_dir: dir} do
    c = fly(dir, [:inav], %{"timeouts" => %{"vehicle_stale_s" => 2.0, "vehicle_lost_s" => 120.0}})
    sim = c.sims.inav
    # As after kill -9 of the program that simulates it.
    :ok = Msp.change(sim, &%{&1 | dead: true})
    status = fn -> Aerie.Base.Store.vehicle(c.gateway, key(:inav)).status end
    eventually(fn -> status.() != :online end, "it is not heard")
    :ok = Msp.change(sim, &%{&1 | dead: false})
    eventually(fn -> status.() == :online end, "it is heard again")
    assert [_one] = Aerie.Fleet.vehicles(c.gateway)
  end

  # A vehicle that answers too late is silence to a program, which asks again by itself.
  defp request(port, frames), do: request(port, frames, Aerie.Patience.deadline())

  defp request(port, frames, until) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false], Aerie.Patience.ms())
    :ok = :gen_tcp.send(socket, for(frame <- frames, do: MavCodec.Msp.Frame.encode(frame)))
    answers = answers(socket, MavCodec.Msp.Parser.new(), [], length(frames))
    :gen_tcp.close(socket)

    cond do
      length(answers) == length(frames) -> answers
      System.monotonic_time(:millisecond) < until -> request(port, frames, until)
      true -> flunk("port #{port} answered only #{inspect(answers)}")
    end
  end

  defp answers(socket, parser, got, count) when length(got) < count do
    case :gen_tcp.recv(socket, 0, 10_000) do
      {:ok, bytes} ->
        {more, parser} = MavCodec.Msp.Parser.push(parser, bytes)
        answers(socket, parser, got ++ more, count)

      {:error, _silent_or_closed} ->
        got
    end
  end

  defp answers(_socket, _parser, got, _count), do: got

  test "a configurator shares the vehicle: it reads all, changes what the policy gives it, and what it left is undone",
       %{tmp_dir: dir} do
    alias MavCodec.Msp.Frame
    sim = start_supervised!({Msp, firmware: :betaflight, uid: 7})
    [operators, admins] = for _n <- 1..2, do: HubServer.free_port()

    %{gateway: gateway} =
      start_gateway(dir,
        links: [],
        overrides: %{
          "timeouts" => patient(),
          "links" => [
            %{"url" => "msp:tcp:127.0.0.1:#{Msp.port(sim)}?sysid=7&share=#{operators}", "id" => "bench"},
            %{"url" => "msp:tcp:127.0.0.1:#{Msp.port(sim)}?sysid=8&share=#{admins}", "id" => "hangar"}
          ],
          "policy" => %{
            "clients" => [%{"id" => "hangar-share", "role" => "admin"}]
          }
        }
      )

    for system <- [7, 8],
        do:
          eventually(
            fn -> match?(%{autopilot: :betaflight}, Aerie.Base.Store.vehicle(gateway, {"main", system})) end,
            "it is known"
          )

    # YAMSPy reads by the gateway what it reads at the vehicle.
    assert %{"variant" => "BTFL", "api" => "1.46.0", "roll_p" => "45"} =
             findings(start_peer("yamspy_reader.py", [operators]))

    pid = fn p -> %Frame{id: 202, payload: <<p, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14>>} end
    # A program of this machine is an operator, who does not change parameters.
    assert [%{direction: :error}, %{id: 2, direction: :reply}] = request(operators, [pid.(99), %Frame{id: 2}])
    assert [%{id: 202, direction: :reply}] = request(admins, [pid.(77)])
    assert <<77, 1, 2, _::binary>> = Msp.state(sim).blocks[112]
    # Disabled, and enabled again when it is gone.
    assert [%{id: 99, direction: :reply}] = request(admins, [%Frame{id: 99, payload: <<1, 0>>}])
    Msp.await(sim, fn fc -> not Enum.any?(fc.ports, fn {_id, port} -> port.disabled end) end)

    entries = Path.wildcard(Path.join(dir, "audit/*")) |> Enum.map_join(&File.read!/1)
    assert entries =~ "bench-share" and entries =~ "hangar-share"
  end

  test "YAMSPy reads the simulated Betaflight as it reads a real one" do
    sim = start_supervised!({Msp, firmware: :betaflight, uid: 1})
    Msp.await(sim, &(&1.now > 4_000_000))
    found = findings(start_peer("yamspy_reader.py", [Msp.port(sim)]))

    assert %{
             "variant" => "BTFL",
             "api" => "1.46.0",
             "cells" => "4",
             "satellites" => "14",
             "throttle" => "1000",
             "roll_p" => "45"
           } = found
  end
end
