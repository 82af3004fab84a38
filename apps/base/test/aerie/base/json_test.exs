defmodule Aerie.Base.JsonTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.{Json, Secret}
  alias Aerie.Base.Timing.HostClock

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

  test "all that JSON has is written as the standard encoder writes it" do
    value = %{
      "text" => "a\"b\\c\nä\u2028",
      1 => [],
      a: %{},
      b: %{c: [nil, true, :online, -7, %{"d\"" => 0.5}]},
      at: ~U[2026-11-30 09:41:32.587Z]
    }

    assert Json.encode!(value) == JSON.encode!(value)
    assert Json.encode!(%{}) == "{}"
    # A struct without an encoder is not written as its fields.
    assert_raise Protocol.UndefinedError, fn -> Json.encode!(Secret.new("x")) end
  end

  test "numbers are written as people write them, and read as the same" do
    for {number, text} <- [
          {1000.0, "1000.0"},
          {1.0e6, "1000000.0"},
          {-1.2e-5, "-0.000012"},
          {0.1, "0.1"},
          {-0.0, "-0.0"},
          {47.397742, "47.397742"},
          {1.0e17, "100000000000000000.0"},
          {1.0e18, "1.0e18"},
          {1.0e-9, "1.0e-9"},
          {[%{"a" => 2.0e3}, 7, nil], ~s([{"a":2000.0},7,null])}
        ],
        do: assert({Json.encode!(number), number} == {text, JSON.decode!(text)})

    same = :proper.forall(:proper_types.float(), &(JSON.decode!(Json.encode!(&1)) === &1))

    wide =
      :proper.forall({:proper_types.float(), :proper_types.integer(-30, 30)}, fn {number, power} ->
        number = number * :math.pow(10, power)
        text = Json.encode!(number)
        JSON.decode!(text) === number and text == IO.iodata_to_binary(Json.encode_to_iodata!(number))
      end)

    for property <- [same, wide],
        do:
          assert(
            :proper.quickcheck(property, [:quiet, numtests: 1000]) == true,
            inspect(:proper.counterexample())
          )
  end

  test "a value from outside is shown as JSON, and in short" do
    for {value, text} <- [
          {nil, "null"},
          {1.0e3, "1000.0"},
          {"a\"b", ~S("a\"b")},
          {%{"a" => [true, nil]}, ~s({"a": [true, null]})},
          {Enum.to_list(1..9), "[1, 2, 3, 4, 5, …]"},
          {[], "[]"},
          {:missing, "missing"}
        ],
        do: assert(Json.shown(value, 40) == text)

    long = Json.shown(List.duplicate(String.duplicate("x", 1000), 1000), 40)
    assert String.length(long) == 41 and String.ends_with?(long, "…")
  end

  test "times are UTC with milliseconds" do
    assert Json.time(1_700_000_000_123_456) == "2023-11-14T22:13:20.123Z"
    assert Json.time(nil) == nil

    # As the calendar has it, also on leap days and where its years have other than four digits.
    for us <- [
          0,
          951_782_400_000_000,
          4_107_542_399_999_999,
          253_402_300_799_999_999,
          -1,
          -62_167_219_200_000_001
        ],
        time = us |> DateTime.from_unix!(:microsecond) |> DateTime.truncate(:millisecond),
        do: assert(Json.time(us) == DateTime.to_iso8601(time))
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

  test "numbers are written as people write them" do
    assert Enum.map([5, 5.0, 0.1, 1.0e-5], &Json.number/1) == ["5", "5", "0.1", "1.0e-5"]
  end
end
