defmodule Aerie.Control.Params.SetTest do
  use ExUnit.Case, async: true

  alias Aerie.{LossyLink, ParamsVehicle}
  alias Aerie.Control.Params.Set
  alias MavCodec.Messages, as: M

  @deadline 120_000_000
  @params [{"A", 1, 4}, {"B", 1.5, 9}, {"BIG", 5, 6}]

  defp set(vehicle, name, value, options \\ [], more \\ []) do
    set = Set.new(name, value, {1, 1}, @deadline, [encoding: vehicle.encoding] ++ more)
    LossyLink.run(Set, set, vehicle, &ParamsVehicle.answer/3, options)
  end

  defp get(vehicle, name, options \\ []) do
    get = Set.read(name, {1, 1}, @deadline, encoding: vehicle.encoding)
    LossyLink.run(Set, get, vehicle, &ParamsVehicle.answer/3, options)
  end

  for encoding <- [:c_cast, :bytewise] do
    test "#{encoding}: a value is set when the vehicle shows it (P3)" do
      v = ParamsVehicle.new(@params, encoding: unquote(encoding))
      assert {:ok, %{value: 7, type: 4}} = set(v, "A", 7).result
      assert {:ok, %{value: value}} = set(v, "B", 0.1).result
      assert_in_delta value, 0.1, 1.0e-8
      assert {:ok, %{value: 1}} = get(v, "A").result
    end
  end

  test "the type is read first; with the type, the value goes at once" do
    v = ParamsVehicle.new(@params, encoding: :bytewise)

    assert [{_t, %M.ParamRequestRead{param_id: "A", param_index: -1}}, {_u, %M.ParamSet{param_type: 4}}] =
             set(v, "A", 2).sent

    assert [{_t, %M.ParamSet{}}] = set(v, "A", 2, [], type: 4).sent
  end

  test "a refused set is seen: the vehicle keeps its value, or takes another" do
    v = ParamsVehicle.new(@params, stuck: ["A"], clamp: %{"B" => 3.0})
    assert set(v, "A", 7).result == {:error, {:refused, 1}}
    assert set(v, "B", 9.0).result == {:error, {:refused, 3.0}}
  end

  test "what does not fit is not sent" do
    v = ParamsVehicle.new(@params)
    assert %{result: {:error, {:invalid, _reason}}, sent: [_read]} = set(v, "BIG", 16_777_217)
    assert %{result: {:error, {:invalid, _reason}}, sent: []} = set(v, "A", 1.5, [], type: 4)

    assert {:ok, %{value: 16_777_217}} =
             set(ParamsVehicle.new(@params, encoding: :bytewise), "BIG", 16_777_217).result
  end

  test "a parameter that the vehicle does not have" do
    v = ParamsVehicle.new(@params)
    assert set(v, "NONE", 1).result == {:error, :no_answer}
    assert get(v, "NONE").result == {:error, :no_answer}

    tells = fn v, %M.ParamRequestRead{param_id: name}, _now ->
      {v, [{0, %M.ParamError{param_id: name, error: 1}}]}
    end

    run = LossyLink.run(Set, Set.read("NONE", {1, 1}, @deadline), nil, tells)
    assert run.result == {:error, {:refused, "MAV_PARAM_ERROR_DOES_NOT_EXIST"}}
  end

  test "on a fast link a vehicle may stand still for seconds before it is given up" do
    v = ParamsVehicle.new(@params)
    asleep = LossyLink.still(7_000_000, &ParamsVehicle.answer/3)
    mute = fn v, _message, _now -> {v, []} end

    for type <- [nil, 4] do
      set = Set.new("A", 7, {1, 1}, @deadline, type: type, rtt_us: 5_000)
      assert {:ok, %{value: 7}} = LossyLink.run(Set, set, v, asleep).result
      run = LossyLink.run(Set, set, v, mute)
      assert run.result == {:error, :no_answer}
      # 100, 200 and 400 ms, then 800 ms.
      assert {run.at, length(run.sent)} == {8_700_000, 13}
    end
  end

  test "an old value that comes late is not a refusal" do
    old = %M.ParamValue{param_id: "A", param_value: 1.0, param_type: 4, param_count: 3, param_index: 0}
    script = [{5_000, fn _v -> {:say, {:message, old, {1, 1}, 5_000}} end}]
    assert {:ok, %{value: 7}} = set(ParamsVehicle.new(@params), "A", 7, [script: script], type: 4).result
  end

  test "cancelled, and after its deadline" do
    cancel = [{5_000, fn _v -> {:say, {:cancel, 5_000}} end}]
    assert set(ParamsVehicle.new(@params), "A", 7, script: cancel).result == {:error, :cancelled}
    machine = Set.new("A", 7, {1, 1}, 100_000, type: 4)
    run = LossyLink.run(Set, machine, ParamsVehicle.new(@params), &ParamsVehicle.answer/3, loss: 1.0)
    assert run.result == {:error, :deadline}
    assert {_set, [{:send, [%M.ParamSet{}]}]} = Set.handle(machine, {:start, 0})
  end

  test "whatever the link does: ok means that the vehicle had the value, refused that it showed another" do
    property =
      :proper.forall(scenario(), fn {value, seed, loss, duplicate, jitter, stuck?, px4?} ->
        v =
          ParamsVehicle.new(@params,
            stuck: if(stuck?, do: ["A"], else: []),
            encoding: if(px4?, do: :bytewise, else: :c_cast)
          )

        run =
          set(v, "A", value, seed: seed, loss: loss / 100, duplicate: duplicate / 100, jitter: jitter * 1000)

        case run.result do
          {:ok, param} -> param.value == value and ParamsVehicle.had?(run.vehicle, param)
          {:error, {:refused, 1}} -> stuck? and value != 1
          {:error, :no_answer} -> loss > 20
        end and length(run.sent) <= 60
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end

  defp scenario do
    :proper_types.tuple([
      :proper_types.integer(-100, 100),
      :proper_types.integer(1, 1_000_000),
      :proper_types.integer(0, 40),
      :proper_types.integer(0, 30),
      :proper_types.integer(0, 500),
      :proper_types.boolean(),
      :proper_types.boolean()
    ])
  end
end
