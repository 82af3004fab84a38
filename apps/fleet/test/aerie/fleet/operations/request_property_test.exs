defmodule Aerie.Fleet.Operations.RequestPropertyTest do
  @moduledoc """
  Whatever is sent as a sequence is read, or refused by a few short errors that name its keys. What is read never asks
  for more than its limits, and the same text read again, as from the disk, is the same.
  """
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Operations.{Request, Sequence}

  @ids ["V-1", "V-2", "V-3", "V 3", "", String.duplicate("v", 65), nil, 7, %{}, []]
  @numbers [0, -0.0, 1, 5, 9.999999, 47.3977, -180.0000001, 1.0e308, -1.0e308, 4.9e-324] ++
             [9_007_199_254_740_993, nil, "5", true, [], %{}]
  @types ~w(arm takeoff goto land rtl set_mode set_altitude mission_start hold fly_away) ++ [nil, 7, %{}]
  @waits ~w(above at near landed alone time later) ++ [nil, 7]

  defp some(values), do: :proper_types.oneof(Enum.map(values, &:proper_types.exactly/1))

  # Usually one that is right.
  defp some(values, right), do: :proper_types.frequency([{40, some(right)}, {1, some(values)}])

  # Usually with all keys.
  defp object(fields) do
    pairs = for {name, type} <- fields, do: {name, :proper_types.frequency([{60, type}, {1, :absent}])}
    {names, types} = Enum.unzip(pairs)

    :proper_types.bind(
      :proper_types.fixed_list(types),
      fn values ->
        for {name, value} when value != :absent <- Enum.zip(names, values), into: %{}, do: {name, value}
      end,
      false
    )
  end

  defp step do
    params =
      object([
        {"altitude", some(@numbers, [5, 20])},
        {"lat", some(@numbers, [47.3977])},
        {"lon", some(@numbers, [8, 8.00001])}
      ])

    :proper_types.oneof([
      object([{"type", some(@types, ["goto"])}, {"params", params}]),
      object([{"type", some(@types, ~w(arm land rtl hold mission_start))}]),
      object([
        {"wait", some(@waits, ~w(above at))},
        {"m", some(@numbers, [5, 9.5])},
        {"timeout_s", some(@numbers, [1, 60.5])}
      ]),
      object([{"wait", "near"}, {"m", 3}, {"lat", some(@numbers, [47.3977])}, {"lon", some(@numbers, [8])}]),
      object([
        {"wait", "landed"},
        {"of", some(@ids, ["V-1", "V-2"])},
        {"go_on", some([nil, 1], [true, false])}
      ]),
      some([nil, 7, [], %{}, %{"shadow" => 7}, %{"type" => "rtl", "wait" => "time"}], [
        %{"wait" => "alone"},
        %{"type" => "rtl"}
      ])
    ])
  end

  defp request do
    steps = :proper_types.resize(9, :proper_types.non_empty(:proper_types.list(step())))

    vehicle =
      object([
        {"vehicle", some(@ids, ["V-1", "V-2", "V-3"])},
        {"steps", steps},
        {"else", :proper_types.oneof([steps, []])},
        {"anyway", some([nil, 1], [true])}
      ])

    object([
      {"id", some(["b c", nil, 7], ["a"])},
      {"sequence", :proper_types.resize(4, :proper_types.non_empty(:proper_types.list(vehicle)))},
      {"step", some(@numbers, [1, 5])},
      {"halt_ratio", some(@numbers, [0, 1])},
      {"shown", some([%{"V-1" => "well"}, []], [%{}, %{"V-1" => "ready"}])}
    ])
  end

  defp sound?(%Request{what: {:sequence, vehicles}} = request) do
    Enum.all?(Sequence.futile(vehicles), &(byte_size(to_string(&1)) < 1_000)) and
      request.plan.step in 1..100 and length(vehicles) in 1..2_000 and
      Enum.all?(vehicles, fn %{steps: steps, else: otherwise} ->
        length(steps) in 1..8 and length(otherwise) in 0..8 and
          Enum.all?(steps ++ otherwise, fn
            {:wait, wait} ->
              wait.timeout_ms in 1_000..3_600_000 and (wait.for != :near or match?({_lat, _lon}, wait.place))

            _other ->
              true
          end)
      end)
  end

  test "a sequence from anywhere is read, or refused by few errors" do
    property =
      :proper.forall(request(), fn object ->
        case Request.parse(object, 1_800_000_000_000_000) do
          {:ok, request} ->
            again = object |> Map.put("id", request.id) |> JSON.encode!() |> JSON.decode!()
            sound?(request) and match?({:ok, ^request}, Request.parse(again, 1_900_000_000_000_000))

          {:error, [_ | _] = errors} ->
            Enum.all?(errors, &(byte_size(to_string(&1)) < 1_000))
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 2_000]) == true, inspect(:proper.counterexample())
  end
end
