defmodule Aerie.Base.JsonTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.{HostClock, Json, Secret}

  test "values of the read model become what JSON has" do
    assert Json.plain(%{alt: :nan, v: {:nan, 1}, up: :infinity}) == %{alt: nil, v: nil, up: nil}

    assert Json.plain(%{{"main", 1} => [1.5, true, nil, :online]}) == %{
             "{\"main\", 1}" => [1.5, true, nil, :online]
           }

    assert Json.plain("a\xFFb") == "a\uFFFDb"
    assert Json.plain({1, 2}) == "{1, 2}"

    assert %{a: [<<0xFF>>, {1, self()}]} |> Json.plain() |> JSON.encode!() |> JSON.decode!() |> Map.keys() ==
             ["a"]
  end

  test "times are UTC with milliseconds" do
    assert Json.time(1_700_000_000_123_456) == "2023-11-14T22:13:20.123Z"
    assert Json.time(nil) == nil
  end

  test "a secret shows nowhere but where it is handed over" do
    secret = Secret.new("hunter2")
    refute inspect(%{key: secret}) =~ "hunter2"
    refute to_string(:io_lib.format("~p", [secret])) =~ "hunter2"
    assert Secret.reveal(secret) == "hunter2"
    assert Secret.reveal(nil) == nil
  end

  test "a clock that is set is noticed, one that drifts is not" do
    now = HostClock.offset()
    assert HostClock.step(now, HostClock.offset()) == 0
    assert HostClock.step(now, now + 400_000) == 0
    assert HostClock.step(now, now - 3_600_000_000) == -3_600_000_000
    assert HostClock.step(now, now + 500_000) == 500_000
  end
end
