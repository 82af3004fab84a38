defmodule Aerie.Control.Params.SetExtTest do
  @moduledoc "P8: parameters of a component that speaks PARAM_EXT: lists, single ones, and sets."
  use ExUnit.Case, async: true

  alias Aerie.{LossyLink, ParamsCamera}
  alias Aerie.Control.Params.{Set, Table}
  alias Aerie.Control.Params.Fetch.Download
  alias Aerie.Control.TransferExecutor.Outcome
  alias MavCodec.Messages, as: M

  @deadline 120_000_000

  defp set(name, value, options \\ [], more \\ []) do
    set = Set.new(name, value, {1, 1}, @deadline, [encoding: :extended] ++ more)
    LossyLink.run(Set, set, ParamsCamera.new(), &ParamsCamera.answer/3, options)
  end

  defp list(options) do
    list = Download.new({1, 1}, @deadline, encoding: :extended)
    LossyLink.run(Download, list, ParamsCamera.new(), &ParamsCamera.answer/3, options)
  end

  defp get(name) do
    get = Set.read(name, {1, 1}, @deadline, encoding: :extended)
    LossyLink.run(Set, get, ParamsCamera.new(), &ParamsCamera.answer/3)
  end

  @values %{
    "CAM_MODE" => 1,
    "CAM_EV_STEP" => -3,
    "CAM_FORMAT" => 256,
    "CAM_TINT" => -300,
    "CAM_ISO" => 0x01000200,
    "CAM_TEMP" => -70_000,
    "CAM_FREE" => 0xFFFF_FFFF_FFFF_FFFF,
    "CAM_OFFSET" => -5_000_000_000,
    "CAM_EV" => 1.0,
    "CAM_SHUTTER" => 0.0125,
    "CAM_NAME" => "Nadir",
    "CAM_SERIAL" => "base64:AAEC/w=="
  }

  test "the whole list, with values of every type, whatever is lost" do
    for loss <- [0.0, 0.25, 0.4], seed <- 1..20 do
      assert {:ok, table} = list(loss: loss, seed: seed, duplicate: 0.1, jitter: 100_000).result
      assert Map.new(table.params, fn {name, param} -> {name, param.value} end) == @values
      assert [%{name: "CAM_EV", value: 1.0, type: 9} | _rest] = Table.plain(table).params
    end
  end

  test "one parameter; who has none, or none of this name, does not answer" do
    assert {:ok, %{value: 256, type: 3}} = get("CAM_FORMAT").result
    assert get("CAM_NONE").result == {:error, {:silent, 1}}

    nobody =
      LossyLink.run(
        Download,
        Download.new({1, 1}, @deadline, encoding: :extended),
        nil,
        &{&1, &2 && &3 && []}
      )

    assert nobody.result == {:error, {:silent, 1}}

    assert {:ended, %{status: :timeout, reason: "component 1 does not answer" <> _}} =
             Outcome.of(nobody.result, "a")
  end

  test "a value is set when the component shows it" do
    new = %{
      "CAM_MODE" => 2,
      "CAM_ISO" => 0xFF00_0000,
      "CAM_FREE" => 0,
      "CAM_OFFSET" => -1,
      "CAM_SHUTTER" => 1.0e-300
    }

    new = Map.merge(new, %{"CAM_NAME" => "Höhe", "CAM_TINT" => -1, "CAM_TEMP" => 5.0, "CAM_EV_STEP" => 0})

    for {name, value} <- new do
      assert %{result: {:ok, %{name: ^name, value: shown}}, sent: sent} = set(name, value)
      assert shown == value

      assert [%M.ParamExtRequestRead{}, %M.ParamExtSet{}, %M.ParamExtRequestRead{}] =
               for({_at, m} <- sent, do: m)
    end

    # A float of 32 bits is the nearest one.
    assert {:ok, %{value: value}} = set("CAM_EV", 0.1).result
    assert_in_delta value, 0.1, 1.0e-8
    assert {:ok, %{value: "base64:/w=="}} = set("CAM_NAME", <<255>>).result
    assert {:ok, %{value: "base64:/w=="}} = set("CAM_NAME", "base64:/w==").result
    assert [{_at, %M.ParamExtSet{}} | _read] = set("CAM_MODE", 2, [], type: 1).sent
  end

  test "what a component shows is set, without an acknowledgement, and with leavings behind its text" do
    camera = put_in(ParamsCamera.new().params["CAM_NAME"], "Nadir" <> <<0, "old">>)
    start = fn name, value -> Set.new(name, value, {1, 1}, @deadline, encoding: :extended) end

    # It answers a set with the value.
    shows = fn
      camera, %M.ParamExtSet{param_id: name} = m, now ->
        {camera, _ack} = ParamsCamera.answer(camera, m, now)
        ParamsCamera.answer(camera, %M.ParamExtRequestRead{param_index: -1, param_id: name}, now)

      camera, message, now ->
        ParamsCamera.answer(camera, message, now)
    end

    assert {:ok, %{value: 2}} = LossyLink.run(Set, start.("CAM_MODE", 2), camera, shows).result

    # It says nothing about a set of what it has.
    silent = fn
      camera, %M.ParamExtSet{}, _now -> {camera, []}
      camera, message, now -> ParamsCamera.answer(camera, message, now)
    end

    for {name, value} <- [{"CAM_MODE", 1}, {"CAM_NAME", "Nadir"}] do
      assert {:ok, %{value: ^value}} = LossyLink.run(Set, start.(name, value), camera, silent).result
    end

    # It refuses what it has, and copies text over the text before.
    copies = fn
      camera, %M.ParamExtSet{param_value: <<text::binary-2, 0, _::binary>>} = m, now ->
        {camera, ack} = ParamsCamera.answer(camera, m, now)
        {put_in(camera.params["CAM_NAME"], text <> <<0, "ir", 0, "old">>), ack}

      camera, message, now ->
        ParamsCamera.answer(camera, message, now)
    end

    assert {:ok, %{value: "Up"}} = LossyLink.run(Set, start.("CAM_NAME", "Up"), camera, copies).result
    refused = set("CAM_SERIAL", "base64:AAEC/w==")
    assert {:ok, %{value: "base64:AAEC/w=="}} = refused.result
    assert {:error, {:not_set, :failed, _keeps}} = set("CAM_SERIAL", "x").result
    assert {:error, {:invalid, "expected text without zeros" <> _}} = set("CAM_NAME", <<"a", 0, "b">>).result
  end

  test "IN_PROGRESS is waited on, and the end is known even if its acknowledgement is lost" do
    run = set("CAM_FORMAT", 7)
    assert {:ok, %{value: 7}} = run.result
    assert run.at > 3_000_000
    assert [_one] = for({_at, %M.ParamExtSet{}} <- run.sent, do: :set)

    mute = fn camera, message, now ->
      {camera, answers} = ParamsCamera.answer(camera, message, now)
      {camera, Enum.reject(answers, &match?({_after, %M.ParamExtAck{param_result: 0}}, &1))}
    end

    run =
      LossyLink.run(
        Set,
        Set.new("CAM_FORMAT", 7, {1, 1}, @deadline, encoding: :extended),
        ParamsCamera.new(),
        mute
      )

    assert {:ok, %{value: 7}} = run.result
  end

  test "a refusal has the component's words and the value that stands" do
    assert {:error, {:not_set, :unsupported, {:keeps, 1}}} = error = set("CAM_MODE", 9).result
    assert {:ended, %{status: :rejected, reason: text, details: %{"value" => 1}}} = Outcome.of(error, "a")
    assert text == "the component does not support this value; it keeps 1"
    assert {:error, {:not_set, :failed, {:keeps, "base64:" <> _}}} = error = set("CAM_SERIAL", "x").result

    assert {:ended, %{status: :failed, reason: "the component failed to set it" <> _}} =
             Outcome.of(error, "a")

    # Of the wrong type.
    assert {:error, {:not_set, :failed, {:keeps, 1}}} = set("CAM_MODE", 2, [], type: 3).result
  end

  test "an acceptance is not believed without the value" do
    keeps = fn camera, message, now ->
      {_changed, answers} = ParamsCamera.answer(camera, message, now)
      {camera, answers}
    end

    start = Set.new("CAM_ISO", 3, {1, 1}, @deadline, encoding: :extended)
    result = LossyLink.run(Set, start, ParamsCamera.new(), keeps).result
    assert result == {:error, {:not_set, :accepted, {:keeps, 0x01000200}}}

    assert {:ended, %{status: :failed, reason: "the component accepted the value and does not have it" <> _}} =
             Outcome.of(result, "a")

    shows_nothing = fn
      camera, %M.ParamExtSet{} = m, now -> ParamsCamera.answer(camera, m, now)
      camera, _read, _now -> {camera, []}
    end

    start = Set.new("CAM_ISO", 3, {1, 1}, @deadline, encoding: :extended, type: 5)
    result = LossyLink.run(Set, start, ParamsCamera.new(), shows_nothing).result
    assert {:ended, %{status: :accepted, reason: "it accepted the value" <> _}} = Outcome.of(result, "a")
  end

  test "on a fast link a component may stand still for seconds before it is given up" do
    set = Set.new("CAM_MODE", 2, {1, 1}, @deadline, encoding: :extended, rtt_us: 5_000)
    asleep = LossyLink.still(7_000_000, &ParamsCamera.answer/3)
    assert {:ok, %{value: 2}} = LossyLink.run(Set, set, ParamsCamera.new(), asleep).result
    run = LossyLink.run(Set, set, nil, fn v, _message, _now -> {v, []} end)
    assert run.result == {:error, {:silent, 1}}
    assert {run.at, length(run.sent)} == {8_700_000, 13}

    # It accepts the value, and then stands still.
    stops = fn
      {camera, still}, message, now when now >= still ->
        still = if is_struct(message, M.ParamExtSet), do: now + 7_000_000, else: still
        with {camera, answers} <- ParamsCamera.answer(camera, message, now), do: {{camera, still}, answers}

      standing, _message, _now ->
        {standing, []}
    end

    assert {:ok, %{value: 2}} = LossyLink.run(Set, set, {ParamsCamera.new(), 0}, stops).result
  end

  test "what does not fit is not sent" do
    for {name, value} <- [
          {"CAM_MODE", 256},
          {"CAM_MODE", -1},
          {"CAM_MODE", 1.5},
          {"CAM_MODE", "1"},
          {"CAM_FREE", 0x1_0000_0000_0000_0000},
          {"CAM_EV", 1.0e300},
          {"CAM_NAME", 5},
          {"CAM_NAME", String.duplicate("x", 129)},
          {"CAM_NAME", "base64:?"}
        ] do
      assert %{result: {:error, {:invalid, "expected " <> _}}, sent: [_read]} = set(name, value)
    end
  end

  test "cancelled, and after its deadline" do
    assert set("CAM_ISO", 1, script: [{5_000, fn _v -> {:say, {:cancel, 5_000}} end}]).result ==
             {:error, :cancelled}

    start = Set.new("CAM_FORMAT", 7, {1, 1}, 1_000_000, encoding: :extended)
    run = LossyLink.run(Set, start, ParamsCamera.new(), &ParamsCamera.answer/3)
    assert run.result == {:error, :deadline}
  end

  test "whatever the link does: ok means that the component has the value, not set that it has another" do
    for name <- ["CAM_MODE", "CAM_FORMAT"], value <- [2, 9], loss <- [0.0, 0.25, 0.4], seed <- 1..60 do
      run = set(name, value, seed: seed, loss: loss, duplicate: 0.2, jitter: 300_000)
      has = run.vehicle.params[name] |> :binary.first()

      case run.result do
        {:ok, %{value: ^value}} -> assert has == value
        {:error, {:not_set, :unsupported, {:keeps, 1}}} -> assert {name, has} == {"CAM_MODE", 1}
        {:error, {:not_set, _verdict, :not_shown}} -> assert loss > 0.2
        {:error, {:silent, 1}} -> assert loss > 0.2
      end

      assert length(run.sent) <= 60
    end
  end
end
