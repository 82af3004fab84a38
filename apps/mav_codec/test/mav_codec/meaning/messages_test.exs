defmodule MavCodec.Meaning.MessagesTest do
  use ExUnit.Case, async: true

  alias MavCodec.Meaning.Messages
  alias MavCodec.Meaning.Messages.Rows
  alias MavCodec.MessageId
  alias MavCodec.Dialects.All

  @permissions [:arm, :fly, :mission, :manual, :payload, :telemetry, :sensors, :maintain]
  @orders [:stick, :setpoint, :command, :parameter, :mission, :file, :internal]
  # Names of writes.
  @writes ~r/^(SET_|PARAM_.*SET$|MISSION_(COUNT|ITEM|ITEM_INT|CLEAR_ALL|WRITE_PARTIAL_LIST|SET_CURRENT)$|.*_OVERRIDE|COMMAND_(LONG|INT)$|MANUAL_(CONTROL|SETPOINT)|LOG_ERASE)/

  defp row(name), do: name |> MessageId.of!() |> Messages.row()
  defp rows, do: for(id <- All.ids(), do: {All.name(id), Messages.row(id)})
  defp names(rows), do: for({name, _row} <- rows, do: name)

  test "every message of the definitions has a row, and nothing else has one" do
    missing = for {name, nil} <- rows(), do: name

    assert missing == [],
           "without a row in MavCodec.Meaning.Messages.Rows, so that they reach no vehicle: #{inspect(missing)}"

    assert Enum.sort(Enum.map(Rows.all(), &elem(&1, 0))) == All.ids()
    for id <- [-1, 0xABCDEF, 0xFFFFFF, 16_777_216], do: assert(Messages.row(id) == nil)

    unknown = Enum.reject(0..70_000, &All.name/1)
    assert Enum.filter(unknown, &Messages.row/1) == []
    assert Enum.filter(unknown, &Messages.order?/1) == []
  end

  test "whether a message is an order follows from its class, and from nothing else" do
    for {name, row} <- rows() do
      assert row.order? == row.class in @orders, name
      assert Messages.order?(MessageId.of!(name)) == row.order?, name
    end
  end

  test "no order goes from one vehicle to another, or from a part to its autopilot" do
    assert [] = names(for {_name, %{order?: true}} = row <- rows(), crossing?(row), do: row)
  end

  defp crossing?({_name, row}), do: row.crosses != :never or row.part

  test "an order needs a permission, or goes nowhere because only firmwares say it among themselves" do
    for {name, %{order?: true} = row} <- rows() do
      assert row.permission != nil or row.class == :internal, name
    end
  end

  test "permissions are those that roles can have" do
    assert Enum.uniq(for {_name, %{permission: permission}} <- rows(), permission != nil, do: permission) --
             @permissions == []
  end

  test "a heartbeat is the only message of one vehicle that another one always hears" do
    assert ["HEARTBEAT"] = names(for {_name, %{crosses: :always}} = row <- rows(), do: row)
    assert %{class: :presence, permission: :telemetry} = row("HEARTBEAT")
  end

  test "what another vehicle of the team hears is telemetry, and nothing that answers, asks or measures" do
    assert [:telemetry] = Enum.uniq(for {_name, %{crosses: :team, class: class}} <- rows(), do: class)
  end

  test "what nobody may send to a vehicle is telemetry or stays among firmwares; the rest has a permission" do
    for {name, %{permission: nil} = row} <- rows() do
      assert row.class in [:telemetry, :answer, :internal], name
    end
  end

  test "what may lead a vehicle around a fence is limited; corrections, terrain and clocks are not" do
    for {name, %{limited: true} = row} <- rows(),
        do: assert({row.permission, row.order?} == {:sensors, false}, name)

    limited = names(for {_name, %{limited: true}} = row <- rows(), do: row)

    assert ~w(GPS_INPUT HIL_GPS GLOBAL_POSITION_INT BATTERY_STATUS VISION_POSITION_ESTIMATE ODOMETRY ATT_POS_MOCAP
              LANDING_TARGET DISTANCE_SENSOR OBSTACLE_DISTANCE COLLISION) -- limited == []

    assert ~w(GPS_RTCM_DATA GPS_INJECT_DATA TERRAIN_DATA SYSTEM_TIME OPEN_DRONE_ID_SYSTEM RADIO_STATUS) --
             limited ==
             ~w(GPS_RTCM_DATA GPS_INJECT_DATA TERRAIN_DATA SYSTEM_TIME OPEN_DRONE_ID_SYSTEM RADIO_STATUS)
  end

  test "names that speak of writing are orders" do
    assert [] = for({name, %{order?: false}} <- rows(), name =~ @writes, do: name)
  end

  test "what estimators, clocks and flow control believe is input, and needs the permission for sensors" do
    believed = ~w(GPS_INPUT GPS_INJECT_DATA GPS_RTCM_DATA ODOMETRY RADIO_STATUS LANDING_TARGET SYSTEM_TIME
      OPTICAL_FLOW OPTICAL_FLOW_RAD DISTANCE_SENSOR OBSTACLE_DISTANCE ATT_POS_MOCAP VICON_POSITION_ESTIMATE
      GLOBAL_VISION_POSITION_ESTIMATE HIL_SENSOR HIL_GPS HIL_STATE HIL_STATE_QUATERNION HIL_OPTICAL_FLOW)

    vision = for {name, _row} <- rows(), String.starts_with?(name, "VISION_"), do: name
    assert length(vision) >= 3
    for name <- believed ++ vision, do: assert(%{class: :input, permission: :sensors} = row(name))
    # The other ones of the simulators: sticks, and what a simulated vehicle itself says.
    hil = for {name, row} <- rows(), String.starts_with?(name, "HIL_"), row.class != :input, do: {name, row}

    for {name, row} <- hil do
      assert (row.class == :stick and row.permission == :maintain) or
               (row.class == :telemetry and row.permission == nil),
             name
    end
  end

  test "a clock and a radio's flow control come from no part, and no sensor crosses to another vehicle" do
    for name <- ~w(SYSTEM_TIME RADIO_STATUS HIL_GPS), do: assert(%{part: false} = row(name))
    # A vehicle's own receiver and module.
    for name <- ~w(GPS_INPUT GPS_RTCM_DATA OPEN_DRONE_ID_LOCATION), do: assert(%{part: true} = row(name))

    assert [] =
             names(
               for {_name, %{class: :input, crosses: crosses}} = row <- rows(), crosses != :never, do: row
             )
  end

  test "telemetry that a firmware acts upon has the permission of what it does there" do
    assert %{class: :telemetry, permission: :manual, crosses: :never, part: false} = row("RC_CHANNELS")
    assert %{class: :answer, permission: :arm, crosses: :never, part: false} = row("COMMAND_ACK")
    assert %{class: :setpoint, permission: :fly, crosses: :never} = row("FOLLOW_TARGET")
    assert %{permission: :sensors, crosses: :never} = row("BATTERY_STATUS")
    assert %{permission: :sensors, crosses: :never, part: true} = row("OPEN_DRONE_ID_ARM_STATUS")

    for {name, part} <- [GLOBAL_POSITION_INT: false, COLLISION: false, ADSB_VEHICLE: true, AIS_VESSEL: true],
        do: assert(%{permission: :sensors, crosses: :team, part: ^part} = row(to_string(name)))
  end

  test "sticks and set-points need manual, fly or maintain" do
    for {name, %{class: class} = row} when class in [:stick, :setpoint] <- rows(),
        do: assert(row.permission in [:manual, :fly, :maintain], name)

    for name <- ~w(MANUAL_CONTROL RC_CHANNELS_OVERRIDE SET_ATTITUDE_TARGET SET_POSITION_TARGET_LOCAL_NED),
        do: assert(%{permission: :manual} = row(name))
  end

  test "parameters, and what may hold anything, need maintain; the key of signing goes nowhere" do
    for {name, %{class: :parameter} = row} <- rows(), do: assert(row.permission == :maintain, name)

    for name <- ~w(TUNNEL V2_EXTENSION SERIAL_CONTROL DEVICE_OP_WRITE CAN_FRAME LOG_ERASE SECURE_COMMAND),
        do: assert(%{permission: :maintain} = row(name))

    assert %{class: :internal, permission: nil} = row("SETUP_SIGNING")
  end

  test "only questions with one answer to everybody are asked for somebody else, and not often" do
    for {name, %{per_minute: n} = row} when n > 0 <- rows() do
      assert row.class == :question, name
      assert n <= 60, name
      refute row.part, name
    end

    assert %{per_minute: 1} = row("PARAM_REQUEST_LIST")
  end
end
