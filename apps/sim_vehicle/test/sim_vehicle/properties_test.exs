defmodule SimVehicle.PropertiesTest do
  @moduledoc """
  Whatever a vehicle is told, it does not crash, does not fly disarmed, does not charge its battery, and answers a
  command at most once at once (PX4's second answer comes later).
  """

  use ExUnit.Case, async: true

  import SimVehicle.TestFlight, only: [ready: 1, flying: 1]

  alias MavCodec.Messages, as: M
  alias SimVehicle.Physics.Battery
  alias SimVehicle.Server.Simulation

  @commands [
              16,
              17,
              20,
              21,
              22,
              34,
              84,
              115,
              176,
              177,
              178,
              179,
              185,
              192,
              193,
              205,
              207,
              208,
              224,
              241,
              245,
              246,
              252
            ] ++
              [300, 310, 400, 401, 410, 420, 510, 511, 512, 519, 520, 2000, 3000, 31_999, 42_428]
  @failsafes [:battery, :battery_critical, :gcs, :rc, :fence, :ekf, :gps]

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: no sequence of events breaks it" do
      {standing, _log} = ready(unquote(firmware))
      {hovering, _log} = flying(unquote(firmware))

      property =
        :proper.forall(:proper_types.tuple([:proper_types.boolean(), :proper_types.list(event())]), fn {high?,
                                                                                                        events} ->
          start = if high?, do: hovering, else: standing
          Enum.reduce_while(events, {true, start}, &check/2) |> elem(0)
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 150, max_size: 40]) == true,
             inspect(:proper.counterexample())
    end
  end

  defp check(event, {true, before}) do
    {now, actions} = apply_event(before, event)
    # Every value must fit its field.
    for {:send, message} <- actions, do: MavCodec.encode(message, system: now.system, dialect: dialect(now))

    ok =
      rises?(before, now) == false and
        (Battery.remaining(now.battery) <= Battery.remaining(before.battery) or recharges?(event)) and
        now.kin.d <= 0.0 and
        (match?({:wait, _tenths}, event) or length(for {:send, %M.CommandAck{}} <- actions, do: 1) <= 1) and
        length(now.later) <= 200

    if ok, do: {:cont, {true, now}}, else: {:halt, {false, now}}
  end

  # Going up without motors is flying. Falling is not, nor is going on up for a moment after they stop.
  defp rises?(before, now) do
    climbed = before.kin.d - now.kin.d
    highest = :math.pow(min(before.kin.vd, 0.0), 2) / (2 * 9.8)
    not before.armed and not now.armed and climbed > highest + 0.01
  end

  defp recharges?({:failsafe, :battery_critical, false}), do: true
  defp recharges?({:command, 420, _params}), do: true
  defp recharges?(event), do: event == :swap_battery

  defp apply_event(v, {:wait, tenths}), do: Simulation.step(v, tenths / 10)
  defp apply_event(v, {:failsafe, _kind, _on} = event), do: Simulation.handle(v, event)
  defp apply_event(v, :swap_battery), do: Simulation.handle(v, :swap_battery)
  defp apply_event(v, {:command, id, params}), do: hear(v, long(id, params))

  defp apply_event(v, {:int, id, params, {frame, x, y, z}}) do
    [p1, p2, p3, p4 | _rest] = params

    hear(v, %M.CommandInt{
      target_system: 1,
      target_component: 1,
      command: id,
      frame: frame,
      param1: p1,
      param2: p2,
      param3: p3,
      param4: p4,
      x: x,
      y: y,
      z: z
    })
  end

  defp apply_event(v, {:message, message}), do: hear(v, message)

  defp hear(v, message), do: Simulation.handle(v, {:message, message, {255, 190}})

  defp long(id, params) do
    struct!(
      M.CommandLong,
      [target_system: 1, target_component: 1, command: id] ++
        Enum.zip([:param1, :param2, :param3, :param4, :param5, :param6, :param7], params)
    )
  end

  defp dialect(%{plans: %{style: :px4}}), do: MavCodec.Dialects.Upstream
  defp dialect(_ardupilot), do: MavCodec.Dialects.Ardupilot

  # --- what may happen ---

  defp event do
    :proper_types.frequency([
      {4, :proper_types.tuple([:wait, :proper_types.integer(1, 50)])},
      {8, :proper_types.tuple([:command, command_id(), params()])},
      {3, :proper_types.tuple([:int, command_id(), params(), place()])},
      {1, :proper_types.tuple([:failsafe, :proper_types.elements(@failsafes), :proper_types.boolean()])},
      {1, :swap_battery},
      {4, :proper_types.tuple([:message, message()])}
    ])
  end

  defp command_id,
    do:
      :proper_types.frequency([{9, :proper_types.elements(@commands)}, {1, :proper_types.integer(0, 65_535)}])

  defp params, do: :proper_types.vector(7, real())

  defp real do
    :proper_types.frequency([
      {8, :proper_types.elements([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 9.0, 20.0, 510.0, -1.0, 21_196.0])},
      {2, :proper_types.elements([:nan, :infinity, :neg_infinity, 1.0e30, -1.0e30, 1.0e-30, 47.0])},
      {2, :proper_types.float(-1.0e6, 1.0e6)}
    ])
  end

  defp place do
    coordinate =
      :proper_types.frequency([
        {2, :proper_types.integer(-2_147_483_648, 2_147_483_647)},
        {1, 0},
        {1, 2_147_483_647},
        {2, -353_632_610}
      ])

    :proper_types.tuple([:proper_types.integer(0, 22), coordinate, coordinate, real()])
  end

  defp message do
    :proper_types.oneof([
      mission_item(),
      :proper_types.exactly(%M.Heartbeat{type: 6}),
      build(M.MissionCount, count: :proper_types.integer(0, 4), mission_type: :proper_types.integer(0, 4)),
      build(M.MissionRequestInt, seq: :proper_types.integer(0, 9), mission_type: :proper_types.integer(0, 4)),
      build(M.MissionRequestList, mission_type: :proper_types.integer(0, 255)),
      build(M.MissionClearAll, mission_type: :proper_types.elements([0, 1, 2, 7, 255])),
      build(M.MissionSetCurrent, seq: :proper_types.integer(0, 9)),
      build(M.MissionAck, type: :proper_types.integer(0, 20)),
      build(M.SetMode,
        base_mode: :proper_types.integer(0, 255),
        custom_mode: :proper_types.elements([0, 3, 4, 5, 6, 9, 77, 50_593_792, 4_294_967_295])
      ),
      build(M.SetPositionTargetLocalNed,
        x: real(),
        y: real(),
        z: real(),
        vx: real(),
        vy: real(),
        vz: real(),
        yaw: real(),
        yaw_rate: real(),
        type_mask: type_mask(),
        coordinate_frame: :proper_types.integer(0, 12)
      ),
      build(M.SetPositionTargetGlobalInt,
        lat_int: :proper_types.integer(-2_000_000_000, 2_000_000_000),
        lon_int: :proper_types.integer(),
        alt: real(),
        type_mask: type_mask(),
        coordinate_frame: :proper_types.integer(0, 12)
      ),
      build(M.ParamRequestRead, param_index: :proper_types.integer(-3, 400), param_id: name()),
      build(M.ParamSet, param_id: name(), param_value: real(), param_type: :proper_types.integer(0, 12)),
      build(M.RequestDataStream,
        req_stream_id: :proper_types.integer(0, 13),
        req_message_rate: :proper_types.integer(0, 1000),
        start_stop: :proper_types.integer(0, 2)
      ),
      build(M.RequestEvent,
        first_sequence: :proper_types.integer(0, 65_535),
        last_sequence: :proper_types.integer(0, 65_535)
      ),
      build(M.Timesync, tc1: :proper_types.integer(0, 1), ts1: :proper_types.integer()),
      build(M.Ping, seq: :proper_types.integer(0, 9))
    ])
  end

  defp mission_item do
    build(M.MissionItemInt,
      seq: :proper_types.integer(0, 3),
      command:
        :proper_types.elements([16, 17, 18, 19, 20, 21, 22, 82, 93, 177, 178, 5001, 5002, 5100, 31_000]),
      frame: :proper_types.elements([0, 2, 3, 5, 6, 11]),
      param1: real(),
      param2: real(),
      x: :proper_types.elements([0, -353_632_610, -353_630_000, 910_000_000]),
      y: :proper_types.elements([0, 1_491_652_300, 1_491_655_000]),
      z: real(),
      mission_type: :proper_types.elements([0, 0, 0, 1, 2])
    )
  end

  defp name,
    do:
      :proper_types.elements([
        "RTL_ALT",
        "WPNAV_SPEED",
        "DISARM_DELAY",
        "MPC_XY_CRUISE",
        "RTL_RETURN_ALT",
        "BATT_LOW_MAH",
        "_HASH_CHECK",
        "",
        "NO_SUCH",
        "SIM_GPS_USED",
        "MIS_TKO_LAND_REQ",
        "FENCE_ENABLE",
        "NAV_ACC_RAD"
      ])

  defp type_mask, do: :proper_types.elements([0, 0x7, 0x38, 0xFF8, 0xFC7, 0xDC7, 0xBC7, 0x5C7, 0xFFFF])

  defp build(module, fields) do
    target =
      Enum.filter([target_system: 1, target_component: 1], fn {key, _one} ->
        is_map_key(struct(module), key)
      end)

    values = Enum.map(fields, fn {_key, type} -> type end)
    make = fn given -> struct!(module, target ++ Enum.zip(Keyword.keys(fields), given)) end
    # A PropEr "let": the struct is made of what was drawn.
    :proper_types.bind(:proper_types.fixed_list(values), make, false)
  end
end
