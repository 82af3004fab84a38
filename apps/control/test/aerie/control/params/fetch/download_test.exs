defmodule Aerie.Control.Params.Fetch.DownloadTest do
  use ExUnit.Case, async: true

  alias Aerie.{Flight, LossyLink, ParamsVehicle}
  alias Aerie.Control.Params.Table
  alias Aerie.Control.Params.Fetch.Download
  alias MavCodec.Messages, as: M

  @deadline 300_000_000

  defp run(vehicle, options \\ [], more \\ []) do
    download =
      Download.new(
        {1, 1},
        @deadline,
        [encoding: vehicle.encoding, hash: vehicle.encoding == :bytewise] ++ more
      )

    LossyLink.run(Download, download, vehicle, &ParamsVehicle.answer/3, options)
  end

  defp values(%Table{params: params}), do: Map.new(params, fn {name, p} -> {name, {p.value, p.type}} end)
  defp values(vehicle), do: Map.new(vehicle.params, fn {name, value, type} -> {name, {value, type}} end)

  test "a list over a good link is asked for once (P4)" do
    run = run(ParamsVehicle.new(ParamsVehicle.some(300)))
    assert {:ok, table} = run.result
    assert values(table) == values(run.vehicle)
    assert [{_at, %M.ParamRequestList{}}] = run.sent
    assert List.last(run.progress) == {300, 300}
    assert length(run.progress) <= 101
  end

  test "a slow radio has the time that the number of parameters needs, unless it was limited (P4)" do
    slow = ParamsVehicle.new(ParamsVehicle.some(1_400), pace: 250_000)
    assert {:ok, table} = run(slow, [loss: 0.02], each_us: 1_000_000).result
    assert map_size(table.params) == 1_400
    assert {:error, :deadline} = run(slow).result
  end

  test "what is lost is requested by index, ten at a time, and nothing else is" do
    run = run(ParamsVehicle.new(ParamsVehicle.some(200)), loss: 0.25, seed: 7)
    assert {:ok, table} = run.result
    assert values(table) == values(run.vehicle)

    [{_at, %M.ParamRequestList{}} | reads] =
      Enum.drop_while(run.sent, &match?({_at, %M.ParamRequestList{}}, &1)) |> then(&[hd(run.sent) | &1])

    assert Enum.all?(reads, fn {_at, m} -> match?(%M.ParamRequestRead{param_id: ""}, m) end)
    assert reads |> Enum.take_while(fn {at, _m} -> at == elem(hd(reads), 0) end) |> length() == 10
  end

  test "a list that changes while it is read begins again (P5, P7)" do
    appears = &ParamsVehicle.appear(&1, 50, {"NEW", 1, 6})
    run = run(ParamsVehicle.new(ParamsVehicle.some(200)), script: [{200_000, appears}], loss: 0.1)
    assert {:ok, table} = run.result
    assert values(table) == values(run.vehicle)
    assert table.params["NEW"].value == 1

    vanishes = &ParamsVehicle.vanish(&1, "P50")
    run = run(ParamsVehicle.new(ParamsVehicle.some(200)), script: [{200_000, vanishes}], loss: 0.1)
    assert {:ok, table} = run.result
    refute is_map_key(table.params, "P50")
  end

  test "a list that always changes is given up" do
    script = for n <- 1..1000, do: {n * 100_000, &ParamsVehicle.appear(&1, 1, {"N#{n}", n, 6})}
    run = run(ParamsVehicle.new(ParamsVehicle.some(200)), script: script, loss: 0.2)
    assert run.result == {:error, :changing}
  end

  test "a value that somebody sets in the meantime is the one in the list" do
    set = fn vehicle -> ParamsVehicle.put(vehicle, "P1", 99) end
    v = ParamsVehicle.new(ParamsVehicle.some(100))

    message = %M.ParamValue{
      param_id: "P1",
      param_value: 99.0,
      param_type: 4,
      param_count: 100,
      param_index: 65_535
    }

    script = [{100_000, set}, {110_000, fn _v -> {:say, {:message, message, {1, 1}, 110_000}} end}]
    assert {:ok, table} = run(v, script: script).result
    assert table.params["P1"].value == 99
  end

  test "PX4's hash belongs to the list only if it was the same before and after (P6)" do
    v = ParamsVehicle.new(ParamsVehicle.some(100), encoding: :bytewise)
    assert {:ok, %Table{hash: hash}} = run(v).result
    assert hash != nil
    set = &ParamsVehicle.put(&1, "P1", 99)
    assert {:ok, %Table{hash: nil}} = run(v, script: [{150_000, set}]).result

    # On a fast link the vehicle may stand still for seconds before the second one.
    still = fn
      v, %M.ParamRequestRead{}, now when now in 100_000..7_000_000 -> {v, []}
      v, message, now -> ParamsVehicle.answer(v, message, now)
    end

    download = Download.new({1, 1}, @deadline, encoding: :bytewise, hash: true, rtt_us: 5_000)
    assert {:ok, %Table{hash: ^hash}} = LossyLink.run(Download, download, v, still).result
  end

  test "a vehicle that restarts is read again" do
    script = [{200_000, fn v -> {:reboot, v} end}]
    run = run(ParamsVehicle.new(ParamsVehicle.some(200)), script: script)
    assert {:ok, _table} = run.result
    assert Enum.count(run.sent, &match?({_at, %M.ParamRequestList{}}, &1)) == 2
  end

  test "every end: no answer, deadline, cancelled, too many" do
    silent = fn v, _message, _now -> {v, []} end
    download = Download.new({1, 1}, @deadline)
    assert LossyLink.run(Download, download, nil, silent).result == {:error, :no_answer}
    assert LossyLink.run(Download, Download.new({1, 1}, 2_000_000), nil, silent).result == {:error, :deadline}

    cancel = [{100_000, fn _v -> {:say, {:cancel, 100_000}} end}]
    assert run(ParamsVehicle.new(ParamsVehicle.some(200)), script: cancel).result == {:error, :cancelled}

    {d, _actions} = Download.handle(download, {:start, 0})
    many = %M.ParamValue{param_id: "A", param_value: 1.0, param_type: 9, param_count: 60_000, param_index: 1}
    assert {_d, [{:done, {:error, {:too_many, 60_000}}}]} = Download.handle(d, {:message, many, {1, 1}, 1})
  end

  test "one whose list is being read over MSP begins late, and is waited for" do
    late = fn
      v, message, now when now >= 40_000_000 -> ParamsVehicle.answer(v, message, now)
      v, _message, _now -> {v, []}
    end

    run = fn options ->
      LossyLink.run(
        Download,
        Download.new({1, 1}, @deadline, options),
        ParamsVehicle.new(ParamsVehicle.some(20)),
        late
      )
    end

    assert run.([]).result == {:error, :no_answer}
    assert {:ok, %Table{} = table} = run.(begins_us: 60_000_000).result
    assert Table.count(table) == 20

    silent = fn v, _message, _now -> {v, []} end
    gave_up = LossyLink.run(Download, Download.new({1, 1}, @deadline, begins_us: 60_000_000), nil, silent)
    assert gave_up.result == {:error, :no_answer}
    assert gave_up.at in 60_000_000..70_000_000
  end

  test "a vehicle that goes silent in the middle is given up after half a minute" do
    dies = fn v, message, now ->
      if now < 300_000, do: ParamsVehicle.answer(v, message, now), else: {v, []}
    end

    run =
      LossyLink.run(
        Download,
        Download.new({1, 1}, @deadline),
        ParamsVehicle.new(ParamsVehicle.some(20), stuck: []),
        fn
          v, %M.ParamRequestList{} = m, now ->
            with {v, said} <- dies.(v, m, now), do: {v, Enum.take(said, 10)}

          v, _m, _now ->
            {v, []}
        end
      )

    assert {:error, reason} = run.result
    assert reason in [:no_answer, {:missing, 10}]
    assert run.at < 120_000_000
  end

  test "garbage names and other systems are not heard" do
    {d, _actions} = Download.handle(Download.new({1, 1}, @deadline), {:start, 0})

    value = %M.ParamValue{
      param_id: "NO_S(<" <> <<0xC3, 0xA9>>,
      param_value: 1.0,
      param_type: 9,
      param_count: 1,
      param_index: 0
    }

    assert {%{ignored: 1} = d, []} = Download.handle(d, {:message, value, {1, 1}, 1})
    assert {^d, []} = Download.handle(d, {:message, %{value | param_id: "A"}, {2, 1}, 1})
  end

  for {flight, encoding, hash, count} <- [
        {"arducopter_flight", :c_cast, false, 1392},
        {"px4_flight", :bytewise, true, 887}
      ] do
    test "#{flight}: the list that the real firmware sent" do
      {d, _actions} =
        Download.handle(
          Download.new({1, 1}, @deadline, encoding: unquote(encoding), hash: unquote(hash)),
          {:start, 0}
        )

      messages =
        for %{id: 22} = frame <- Flight.frames(unquote(flight)), {:ok, m} <- [MavCodec.decode(frame)], do: m

      {_d, result} =
        Enum.reduce_while(messages, {d, nil}, fn m, {d, _result} ->
          case Download.handle(d, {:message, m, {1, 1}, 1000}) do
            {d, actions} ->
              done = for {:done, result} <- actions, do: result
              if done == [], do: {:cont, {d, nil}}, else: {:halt, {d, hd(done)}}
          end
        end)

      assert {:ok, table} = result
      assert Table.count(table) == unquote(count)
      if unquote(hash), do: assert(table.hash == 799_782_357)
    end
  end

  test "whatever the link does: every value was the vehicle's, the names are its names, and it ends" do
    property =
      :proper.forall(scenario(), fn {n, px4?, seed, loss, duplicate, jitter, changes} ->
        v = ParamsVehicle.new(ParamsVehicle.some(n), encoding: if(px4?, do: :bytewise, else: :c_cast))
        script = for {{at, what}, n} <- Enum.with_index(changes), do: {at * 1000, change(what, n)}

        run =
          run(v,
            seed: seed,
            loss: loss / 100,
            duplicate: duplicate / 100,
            jitter: jitter * 1000,
            script: script
          )

        case run.result do
          {:ok, table} ->
            Enum.all?(Map.values(table.params), &ParamsVehicle.had?(run.vehicle, &1)) and
              (listed(changes) > 0 or values(table) |> Map.keys() == values(run.vehicle) |> Map.keys())

          {:error, :changing} ->
            listed(changes) > 0

          # Five requests for the list, none of which arrived: one in a hundred thousand at 10 %, one in a thousand at 25 %.
          {:error, :no_answer} ->
            loss > 10

          {:error, _reason} ->
            loss > 25
        end and length(run.sent) < 4000
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  defp listed(changes), do: Enum.count(changes, &match?({_at, what} when what != :put, &1))

  # A vehicle has no two parameters of one name.
  defp change(:appear, n), do: &ParamsVehicle.appear(&1, 0, {"NEW#{n}", 1, 6})
  defp change(:put, _n), do: &ParamsVehicle.put(&1, "P1", 50)
  defp change(:vanish, _n), do: &ParamsVehicle.vanish(&1, "P2")
  defp change(:reboot, _n), do: fn v -> {:reboot, v} end

  defp scenario do
    :proper_types.tuple([
      :proper_types.integer(3, 60),
      :proper_types.boolean(),
      :proper_types.integer(1, 1_000_000),
      :proper_types.integer(0, 40),
      :proper_types.integer(0, 20),
      :proper_types.integer(0, 300),
      :proper_types.resize(
        3,
        :proper_types.list(
          :proper_types.tuple([
            :proper_types.integer(0, 1500),
            :proper_types.oneof([:put, :appear, :vanish, :reboot])
          ])
        )
      )
    ])
  end

  test "a name is 1 to 16 printable characters (P1)" do
    assert MavCodec.Ftp.PackedParams.name?("ABCDEFGHIJKLMNOP")

    for bad <- ["", "ABCDEFGHIJKLMNOPQ", "A B", <<255>>, nil],
        do: refute(MavCodec.Ftp.PackedParams.name?(bad))
  end
end
