defmodule Protocols.Mission.KeptTest do
  @moduledoc "What a firmware keeps of a plan counts as the same, and everything else as a difference (W8)."
  use ExUnit.Case, async: true

  alias Protocols.Mission.{Item, Onboard, Plan}
  alias Protocols.Mission.File.{QgcPlan, Waypoints}
  alias Protocols.Mission.Transfer.Compare
  alias Aerie.PlanExchange
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Messages.MissionItemInt

  @plans Path.expand("../../fixtures/plans", __DIR__)

  defp plan(name) do
    text = File.read!(Path.join(@plans, name))
    reader = if Path.extname(name) == ".plan", do: QgcPlan, else: Waypoints
    {:ok, plan} = reader.read(text)
    plan
  end

  defp upload(firmware, plan, type \\ 0) do
    protocol = Firmware.of(firmware)
    items = Onboard.items(plan, type, protocol)

    {result, sent, _plans} =
      PlanExchange.transfer(PlanExchange.plans(firmware), {:upload, items}, type, protocol)

    {result, for(%MissionItemInt{} = m <- sent, uniq: true, do: m)}
  end

  defp item(command, more \\ []),
    do: struct!(%Item{command: command, frame: 3, x: 471_000_000, y: 81_000_000, z: 20.0}, more)

  defp params(command, params, more \\ []), do: item(command, [{:params, params} | more])

  # The file, and how the vehicle's last item differs from what was sent.
  @cases [
    {"b01-land-p4-0.waypoints", params: {0.0, 0.0, 0.0, 1.0}},
    {"b01-rtl-frame3.waypoints", frame: 0},
    {"b01-speed-frame3.waypoints", frame: 0},
    {"b01-loiter-time-p3-0.waypoints", params: {10.0, 0.0, 1.0, 0.0}},
    {"b01-alt-mm.waypoints", z: 20.12},
    {"b01-wp-yaw.waypoints", params: {0.0, 0.0, 0.0, 0.0}},
    {"b01-wp-acceptance.waypoints", params: {0.0, 0.0, 0.0, 0.0}},
    {"b01-jump-frame3.waypoints", frame: 0},
    {"b01-wp-hold-2.5.waypoints", params: {2.0, 0.0, 0.0, 0.0}},
    {"b01-loiter-turns-301.waypoints", params: {1.0, 0.0, 300.0, 0.0}},
    {"b01-rtl-alt.waypoints", z: 0.0},
    {"b01-mount-z0.waypoints", z: 2.0},
    {"b01-takeoff-p4.waypoints", params: {0.0, 0.0, 0.0, 0.0}},
    {"b01-speed-p4.waypoints", params: {1.0, 5.0, -1.0, 0.0}},
    {"b01-qgc-land.plan", params: {0.0, 0.0, 0.0, 1.0}},
    {"b01-qgc-rtl-frame3.plan", frame: 0}
  ]

  for {name, changed} <- @cases do
    test "ArduPilot: #{name} is completed" do
      {result, sent} = upload(:ardupilot, plan(unquote(name)))
      assert %{status: :completed, on_board: :new, reason: nil, mismatch: nil} = result
      read = List.last(result.items)

      kept = sent |> List.last() |> Item.read() |> struct!(unquote(Macro.escape(changed)))
      # 2012 cm are 20.119999 m.
      assert_in_delta read.z, kept.z, 1.0e-5
      assert %{read | z: kept.z} == kept
      # What was not set is not missed.
      assert result.remarks != [] or Path.extname(unquote(name)) == ".plan"
    end
  end

  @placeless [
    {"b03-digicam-frame3.waypoints", 1},
    {"b03-digicam-frame3.plan", 1},
    {"b03-digicam-frame0.waypoints", 1},
    {"b03-gimbal-frame3.waypoints", 12},
    {"b03-gimbal-120-frame3.waypoints", 120}
  ]

  for {name, x} <- @placeless do
    test "#{name}: x is #{x} on the wire, on board, and in the file that is read back" do
      plan = plan(unquote(name))
      {result, sent} = upload(:ardupilot, plan)
      assert List.last(sent).x == unquote(x)
      assert %{status: :completed, items: items} = result
      assert List.last(items).x == unquote(x)

      stored = Onboard.put(%Plan{home: plan.home}, 0, items, Firmware.Ardupilot.Adapter)
      assert %{"mission" => %{"items" => shown}} = JSON.decode!(QgcPlan.write(stored))
      assert Enum.at(List.last(shown)["params"], 4) == unquote(x)
      assert Waypoints.write(stored) |> String.split() |> Enum.at(-4) == "#{unquote(x)}"
      assert {:ok, %{items: again}} = Waypoints.read(Waypoints.write(stored))
      assert List.last(again).x == unquote(x)
    end
  end

  test "parameters 5 and 6 of a command without a place are whole, and degrees in those that it does not have" do
    line = fn text -> Waypoints.read("QGC WPL 110\n0 1 0 16 0 0 0 0 47.1 8.1 400 1\n1 0 3 #{text} 1") end

    assert {:ok, %{items: [%{x: 471_000_000, y: 81_000_000}]}} = line.("20 0 0 0 0 47.1 8.1 0")
    assert {:ok, %{items: [%{x: 0, y: 0}]}} = line.("178 1 5 -1 0 nan nan 0")

    assert {:error, "line 3 param5: expected a whole number, because the command has no place" <> _} =
             line.("203 0 0 0 0 0.5 0 0")

    assert {:ok, %{items: [%{x: 470_000_000}]}} = line.("16 0 0 0 0 47 8 0")
  end

  # What is sent to ArduPilot (command, parameters, more) and what it keeps, by kind of vehicle.
  @kept [
    {"copter", 16, {2.5, 5.0, 7.0, 90.0}, {2.0, 0.0, 0.0, 0.0}},
    {"rover", 16, {2.5, 5.0, 7.0, 90.0}, {2.0, 0.0, 0.0, 0.0}},
    {"plane", 16, {2.5, 5.9, 300.0, 90.0}, {0.0, 5.0, 255.0, 0.0}},
    {"vtol", 16, {2.5, 30.0, 0.0, nil}, {0.0, 30.0, 0.0, 0.0}},
    {"plane", 17, {0.0, 0.0, -80.7, 45.0}, {0.0, 0.0, -80.0, 0.0}},
    {"copter", 18, {2.5, 0.0, -301.0, 1.0}, {2.0, 0.0, -300.0, 1.0}},
    {"plane", 18, {300.0, 0.0, 2557.0, 0.0}, {255.0, 0.0, 2550.0, 0.0}},
    {"plane", 18, {0.5, 0.0, 255.5, 0.5}, {0.5, 0.0, 250.0, 1.0}},
    {"plane", 19, {10.9, 1.0, -60.0, 1.0}, {10.0, 0.0, -1.0, 1.0}},
    {"plane", 21, {25.5, 1.0, 0.0, -90.0}, {25.0, 0.0, 0.0, -1.0}},
    {"plane", 22, {15.0, 0.0, 0.0, nil}, {15.0, 0.0, 0.0, 0.0}},
    {"plane", 31, {1.0, -90.5, 0.0, 1.0}, {0.0, -90.0, 0.0, 1.0}},
    {"copter", 82, {3.7, 1.0, 1.0, 1.0}, {3.0, 0.0, 0.0, 0.0}},
    {"vtol", 84, {1.0, 2.0, 3.0, nil}, {0.0, 0.0, 0.0, 0.0}},
    {"vtol", 85, {1.0, 0.0, 5.0, nil}, {1.0, 0.0, 0.0, 0.0}},
    {"copter", 93, {2.5, -1.0, 12.0, 30.5}, {2.5, -1.0, 12.0, 30.0}},
    {"copter", 94, {5.256, 0.0, 0.0, 0.0}, {5.25, 0.0, 0.0, 0.0}},
    {"copter", 112, {2.5, 1.0, 1.0, 1.0}, {2.5, 0.0, 0.0, 0.0}},
    {"copter", 115, {45.5, 10.5, -1.0, 1.0}, {45.5, 10.5, -1.0, 1.0}},
    {"copter", 177, {2.0, -1.0, 3.0, 0.0}, {2.0, -1.0, 0.0, 0.0}},
    {"rover", 178, {1.0, 3.25, 50.0, 1.0}, {1.0, 3.25, 50.0, 0.0}},
    {"plane", 183, {9.0, 1500.5, 1.0, 1.0}, {9.0, 1500.0, 0.0, 0.0}},
    {"rover", 194, {1.0, 1.0, 0.0, 0.0}, {1.0, 0.0, 0.0, 0.0}},
    {"copter", 205, {-90.0, 0.5, 10.0, 4.0}, {-90.0, 0.5, 10.0, 0.0}},
    {"plane", 206, {25.5, 1000.0, 1.0, 1.0}, {25.5, 0.0, 1.0, 0.0}},
    {"rover", 213, {90.5, 2.5, 1.0, 1.0}, {90.5, 2.5, 1.0, 0.0}},
    {"copter", 222, {10.5, 2.5, 50.0, 100.5}, {10.0, 2.5, 50.0, 100.5}},
    {"plane", 223, {1.0, 0.5, 30.256, 1.0}, {1.0, 1.0, 30.25, 1.0}},
    {"copter", 1000, {-45.5, 10.5, 1.0, 1.0}, {-45.0, 10.0, 1.0, 1.0}},
    {"copter", 42_600, {1.0, 2.0, 3.5, 0.5}, {1.0, 2.0, 3.5, 0.5}}
  ]

  defp compare(sent, read, protocol, kind \\ "copter") do
    # ArduPilot's first item is home.
    first = if protocol == Firmware.Ardupilot.Adapter, do: [item(16)], else: []
    Compare.plans(first ++ List.wrap(sent), first ++ List.wrap(read), 0, protocol, kind)
  end

  for {{kind, command, sent, kept}, n} <- Enum.with_index(@kept) do
    test "ArduPilot, #{kind}, command #{command} (#{n}): keeps what its structure holds, and no other value" do
      {sent, kept} = {params(unquote(command), unquote(Macro.escape(sent))), unquote(Macro.escape(kept))}

      assert {:same, _remarks} =
               compare(sent, %{sent | params: kept}, Firmware.Ardupilot.Adapter, unquote(kind))

      # A parameter that is kept must not come back as another number.
      for index <- 0..3, elem(kept, index) != 0.0 do
        wrong = put_elem(kept, index, elem(kept, index) + 1.0)
        differs = compare(sent, %{sent | params: wrong}, Firmware.Ardupilot.Adapter, unquote(kind))
        assert {:differs, 1, "item 1 has param" <> _} = differs
      end
    end
  end

  @yaws [
    {1.0, 1.0000001},
    {10.0, 9.999999},
    {123.4, 123.40001},
    {359.5, 359.49997},
    {-90.0, 270.0},
    {360.0, 0.0}
  ]

  test "PX4: the yaw comes back in other words, the pitch of a take-off and the kind of a delay not at all" do
    for {sent, read} <- @yaws, command <- [16, 17, 21, 22, 84, 85] do
      sent = params(command, {0.0, 0.0, 0.0, sent})
      assert compare(sent, params(command, {0.0, 0.0, 0.0, read}), Firmware.Px4.Adapter) == {:same, []}
      turned = params(command, {0.0, 0.0, 0.0, read + 1.0})
      assert {:differs, 0, "item 0 has param4" <> _} = compare(sent, turned, Firmware.Px4.Adapter)
      assert {:differs, 0, _} = compare(sent, params(command, {0.0, 0.0, 0.0, nil}), Firmware.Px4.Adapter)
    end

    takeoff = params(22, {15.0, 0.0, 0.0, nil})

    assert {:same, ["item 0: the vehicle keeps param1 0.0 and not 15.0"]} =
             compare(takeoff, params(22, {0.0, 0.0, 0.0, nil}), Firmware.Px4.Adapter)

    delay = params(112, {5.0, 0.0, 0.0, 0.0}, frame: 2)

    assert {:same, ["item 0: the vehicle keeps command 93 and not 112"]} =
             compare(delay, %{delay | command: 93}, Firmware.Px4.Adapter)

    assert {:differs, 0, _} =
             compare(delay, %{delay | command: 93, params: {6.0, 0.0, 0.0, 0.0}}, Firmware.Px4.Adapter)

    assert {:differs, 0, _} = compare(delay, %{delay | command: 114}, Firmware.Px4.Adapter)
  end

  for {p4, n} <- Enum.with_index([1.0, 10.0, 123.4, 359.5, -90.0, nil]) do
    test "PX4: a plan with the yaw #{inspect(p4)} (#{n}), a pitch and a delay is taken as it is" do
      plan = %Plan{
        items: [
          params(22, {15.0, 0.0, 0.0, unquote(p4)}),
          params(16, {0.0, 0.0, 0.0, unquote(p4)}),
          params(112, {5.0, 0.0, 0.0, 0.0}, frame: 2, x: 0, y: 0, z: 0.0),
          params(177, {2.0, -1.0, 0.0, 0.0}, frame: 2, x: 0, y: 0, z: 0.0)
        ]
      }

      {result, _sent} = upload(:px4, plan)
      # Whether it can be flown, its storage does not say.
      assert %{status: :accepted, on_board: :new, mismatch: nil} = result
    end
  end

  describe "a real difference" do
    @differences [
      z: 20.01,
      z: 19.0,
      z: nil,
      frame: 0,
      frame: 10,
      x: 471_000_001,
      y: 81_000_010,
      command: 82,
      params: {3.0, 0.0, 0.0, 0.0}
    ]

    for {{field, value}, n} <- Enum.with_index(@differences),
        protocol <- [Firmware.Ardupilot.Adapter, Firmware.Px4.Adapter] do
      test "#{inspect(protocol)}: #{field} #{inspect(value)} (#{n})" do
        sent = params(16, {2.0, 0.0, 0.0, 0.0})
        read = Map.put(sent, unquote(field), unquote(Macro.escape(value)))
        assert {:differs, _seq, _how} = compare(sent, read, unquote(protocol))
      end
    end

    test "a missing item, turns, a jump's target and its number, a speed, a servo, a corner, a radius" do
      ardupilot = Firmware.Ardupilot.Adapter
      assert {:differs, 2, _} = compare([item(16), item(16)], [item(16)], ardupilot)

      for {command, sent, read} <- [
            {18, {3.0, 0.0, 0.0, 0.0}, {2.0, 0.0, 0.0, 0.0}},
            {18, {1.0, 0.0, 301.0, 0.0}, {1.0, 0.0, 310.0, 0.0}},
            {18, {1.0, 0.0, 50.0, 0.0}, {1.0, 0.0, -50.0, 0.0}},
            {177, {2.0, 3.0, 0.0, 0.0}, {3.0, 3.0, 0.0, 0.0}},
            {177, {2.0, 3.0, 0.0, 0.0}, {2.0, 2.0, 0.0, 0.0}},
            # What does not fit would become another number.
            {177, {2.0, 40_000.0, 0.0, 0.0}, {2.0, -25_536.0, 0.0, 0.0}},
            {178, {1.0, 5.0, -1.0, 0.0}, {1.0, 5.1, -1.0, 0.0}},
            {183, {9.0, 1500.0, 0.0, 0.0}, {9.0, 1501.0, 0.0, 0.0}}
          ],
          do: assert({:differs, 1, _} = compare(params(command, sent), params(command, read), ardupilot))

      for protocol <- [ardupilot, Firmware.Px4.Adapter] do
        corner = params(5001, {4.0, 0.0, 0.0, 0.0}, frame: 0, z: 0.0)
        circle = params(5003, {50.4, 0.0, 0.0, 0.0}, frame: 0, z: 0.0)
        point = item(5100, z: 20.0)

        for {type, sent, read} <- [
              {1, corner, params(5001, {3.0, 0.0, 0.0, 0.0}, frame: 0, z: 0.0)},
              {1, corner, %{corner | command: 5002}},
              {1, circle, params(5003, {51.0, 0.0, 0.0, 0.0}, frame: 0, z: 0.0)},
              {1, circle, %{circle | x: 1}},
              {2, point, %{point | z: 21.0}},
              {2, point, %{point | z: 19.5}},
              {2, point, %{point | frame: 0}}
            ],
            do: assert({:differs, 0, _} = Compare.plans([sent], [read], type, protocol, "copter"))
      end
    end

    test "a whole centimetre may be cut either way by a float, and nothing else" do
      for cm <- 0..30_000//7 do
        sent = item(16, z: cm / 100)
        assert {:same, _} = compare(sent, item(16, z: cm / 100), Firmware.Ardupilot.Adapter)
        assert {:differs, _, _} = compare(sent, item(16, z: (cm + 1) / 100), Firmware.Ardupilot.Adapter)
        assert {:differs, _, _} = compare(sent, item(16, z: (cm - 2) / 100), Firmware.Ardupilot.Adapter)
      end
    end
  end

  test "fences keep whole metres of circles up to ArduPilot 4.0, rally points in every version" do
    circle = params(5003, {50.4, 0.0, 0.0, 0.0}, frame: 3, z: 5.0)

    for metres <- [50.4, 50.0] do
      read = params(5003, {metres, 0.0, 0.0, 0.0}, frame: 0, z: 0.0, autocontinue: 0)
      assert {:same, _} = Compare.plans([circle], [read], 1, Firmware.Ardupilot.Adapter, "copter")
    end

    plan = %Plan{
      rally: [{{471_000_000, 81_000_000}, 20.9}],
      fence: [{:inclusion, {:circle, {471_000_000, 81_000_000}, 50.4}}]
    }

    assert {%{status: :completed, items: [%{z: 20.0}]}, _sent} = upload(:ardupilot, plan, 2)
    assert {%{status: :completed}, _sent} = upload(:ardupilot, plan, 1)
  end

  test "frames 5, 6 and 11 come back as 0, 3 and 10, and MISSION as 0 if the item has a place" do
    for {sent, read} <- [{5, 0}, {6, 3}, {11, 10}, {2, 0}] do
      assert {:same, _} = compare(item(16, frame: sent), item(16, frame: read), Firmware.Ardupilot.Adapter)
    end

    for {sent, read} <- [{0, 5}, {3, 6}, {5, 0}, {6, 3}],
        do: assert({:same, []} = compare(item(16, frame: sent), item(16, frame: read), Firmware.Px4.Adapter))
  end

  # Two tables from the same source, made apart: the simulator's storage, and what the gateway expects of it.
  for {firmware, frames} <- [ardupilot: [0, 3, 5, 6, 10, 11], px4: [0, 3, 5, 6]] do
    test "#{firmware}: whatever is sent, the vehicle's storage keeps what is expected, and another place or height is seen" do
      commands =
        [16, 17, 18, 19, 20, 21, 22, 31, 82, 84, 93, 112, 114, 115, 177, 178, 179, 181] ++
          [182, 183, 184, 189, 195, 201, 203, 205, 206, 211, 1000, 2000, 2001, 2500, 3000]

      number = :proper_types.oneof([:proper_types.float(0.0, 120.0), :proper_types.integer(0, 120)])
      radius = :proper_types.oneof([:proper_types.float(-3000.0, 3000.0), number])
      height = :proper_types.float(-500.0, 8_000.0)

      property =
        :proper.forall(
          {:proper_types.oneof(commands), :proper_types.oneof(unquote(frames)),
           {number, number, number, number}, radius, height},
          fn {command, frame, {p1, p2, p3, p4}, radius, height} ->
            {p2, p3} =
              {if(command == 31, do: radius, else: p2), if(command in [17, 18, 19], do: radius, else: p3)}

            p2 = if unquote(firmware) == :px4 and command == 21, do: rem(trunc(p2), 4), else: p2
            z = if command == 1000, do: 1.0, else: height
            place? = command in [16, 17, 18, 19, 21, 22, 31, 82, 84, 179, 189, 195, 201]
            # PX4 has commands without a place in the frame MISSION only.
            frame = if unquote(firmware) == :px4 and not place?, do: 2, else: frame
            sent = params(command, {p1 / 1, p2 / 1, p3 / 1, p4 / 1}, frame: frame, x: 120, y: 7, z: z)
            kept = stored(unquote(firmware), sent)
            protocol = Firmware.of(unquote(firmware))

            match?({:same, _}, compare(sent, kept, protocol)) and
              (not place? or
                 (match?({:differs, _, _}, compare(sent, %{kept | x: kept.x + 1}, protocol)) and
                    match?({:differs, _, _}, compare(sent, %{kept | z: kept.z + 0.02}, protocol))))
          end
        )

      assert :proper.quickcheck(property, [:quiet, numtests: 2_000]) == true,
             inspect(:proper.counterexample())
    end
  end

  defp stored(firmware, item) do
    fields = item |> Item.rounded() |> Map.from_struct() |> Map.merge(%{seq: 0, current: 0})

    [kept] =
      firmware |> PlanExchange.plans() |> SimVehicle.Plans.put(0, [fields]) |> SimVehicle.Plans.items(0)

    struct!(Item, Map.drop(kept, [:seq, :current])) |> Item.rounded()
  end

  test "many remarks are counted" do
    sent = for _n <- 1..50, do: params(16, {0.0, 0.0, 0.0, 90.0})
    read = for _n <- 1..50, do: item(16)
    assert {:same, remarks} = compare(sent, read, Firmware.Ardupilot.Adapter)
    assert length(remarks) == 21
    assert List.last(remarks) == "and 30 more"
  end

  # What iNav has afterwards, by the waypoints that are made of the items.
  defp through_inav(items) do
    messages = for {item, seq} <- Enum.with_index(items), do: Item.message(item, seq, 0, {1, 1})

    with {:ok, waypoints} <- Msp.Mission.waypoints(messages), {:ok, read} <- Msp.Mission.items(waypoints) do
      {:ok, Enum.map(read, &Item.read/1)}
    end
  end

  defp inav(sent, read), do: Compare.plans(sent, read, 0, Firmware.Inav.Adapter, "copter")

  test "iNav: any mission that it takes is the same when it is read" do
    value = :proper_types.oneof([0.0, 1.0, 2.4, 7.123, 90.0, -1.0, -2.0, nil])
    command = :proper_types.oneof([16, 16, 19, 20, 21, 115, 177, 178, 195, 197, 201, 31_010])
    frame = :proper_types.oneof([0, 2, 3, 5, 6])

    property =
      :proper.forall(
        :proper_types.non_empty(
          :proper_types.list({command, frame, value, value, value, :proper_types.float(-40.0, 500.0)})
        ),
        fn list ->
          items =
            for {command, frame, a, b, c, z} <- list, do: params(command, {a, b, c, 0.0}, frame: frame, z: z)

          case through_inav(items) do
            {:ok, read} -> match?({:same, _remarks}, inav(items, read))
            {:error, _refused} -> true
          end
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 3000]) == true, inspect(:proper.counterexample())
  end

  test "iNav: a hold becomes its own item, radii are lost, and a real difference is one" do
    items = [params(16, {5.4, 3.0, 0.0, 90.0}), params(201, {3.0, 0.0, 0.0, 0.0}), item(20, frame: 3)]
    {:ok, [hold, roi, back] = read} = through_inav(items)
    assert {19, {5.0, _, _, _}} = {hold.command, hold.params}
    assert {195, 20, 2} = {roi.command, back.command, back.frame}
    assert {:same, [_ | _]} = inav(items, read)
    assert {:differs, 0, _how} = inav(items, [%{hold | z: 20.02}, roi, back])
    assert {:differs, 0, _how} = inav(items, [%{hold | x: hold.x + 1}, roi, back])
    assert {:differs, 0, _how} = inav(items, [%{hold | params: {6.0, 0.0, 0.0, 0.0}}, roi, back])
    assert {:differs, 2, _how} = inav(items, [hold, roi, %{back | params: {1.0, 0.0, 0.0, 0.0}}])
  end
end
