defmodule Aerie.Vehicle.CommandTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Error, Result, Types}

  @now 1_795_000_000_000_000
  @takeoff %{
    "id" => "a1",
    "vehicle" => "VID-001",
    "type" => "takeoff",
    "params" => %{"altitude" => 20},
    "source" => "ops"
  }

  defp errors(envelope) do
    assert {:error, errors} = Command.parse(envelope, @now)
    Enum.map(errors, &Exception.message/1)
  end

  defp param_errors(type, params), do: errors(%{@takeoff | "type" => type, "params" => params})

  test "an envelope becomes a command with its defaults" do
    assert {:ok, command} = Command.parse(@takeoff, @now)

    assert %Command{
             id: "a1",
             vehicle: "VID-001",
             type: "takeoff",
             params: %{altitude: 20.0},
             source: "ops",
             issued_at: @now
           } = command

    assert command.deadline == @now + 10_000_000
    refute Command.expired?(command, @now + 9_999_999)
    assert Command.expired?(command, @now + 10_000_000)
  end

  test "what is written is read back" do
    {:ok, command} = Command.parse(@takeoff, @now)

    assert Command.parse(command |> Command.plain() |> JSON.encode!() |> JSON.decode!(), @now) ==
             {:ok, command}
  end

  test "callers in Elixir need no id and no source" do
    assert {:ok, command} =
             Command.new([vehicle: "V", type: "goto", params: %{lat: 1, lon: 2, altitude: 3}], @now)

    assert command.id =~ ~r/\A[A-Za-z0-9_-]{16}\z/
    assert command.source == "elixir"
    assert command.params == %{lat: 1.0, lon: 2.0, altitude: 3.0, altitude_reference: "home"}
  end

  test "an error says which key, what was expected and what was given" do
    assert errors("takeoff") == [~s(command: expected an object, got "takeoff")]

    assert errors(%{@takeoff | "id" => "a b"}) == [
             ~s(id: expected 1 to 64 letters, digits, - and _, got "a b")
           ]

    assert errors(Map.delete(@takeoff, "vehicle")) == [
             "vehicle: expected 1 to 64 letters, digits, - and _, got nothing"
           ]

    assert [text] = errors(%{@takeoff | "type" => "fly"})
    assert text =~ ~s(type: expected a command such as)
    assert [text] = errors(Map.put(@takeoff, "prams", %{}))
    assert text =~ "prams: expected only id, vehicle"

    assert param_errors("takeoff", %{}) == [
             "params.altitude: expected a number from 0.5 to 1000 (m), got nothing"
           ]

    assert param_errors("takeoff", %{"altitude" => "20"}) == [
             ~s(params.altitude: expected a number from 0.5 to 1000 (m\), got "20")
           ]

    assert param_errors("arm", %{"force" => true}) == [
             "params.force: expected no parameter, because arm has none"
           ]

    assert param_errors("takeoff", [1]) == ["params: expected an object, got [1]"]
  end

  test "names all that is wrong at once" do
    assert [
             "params.speeed: " <> _,
             "params.lat: " <> _,
             "params.lon: " <> _,
             "params.altitude_reference: " <> _
           ] =
             param_errors("goto", %{
               "speeed" => 1,
               "lat" => 95,
               "altitude" => 1,
               "altitude_reference" => "sea"
             })
  end

  test "rules about several parameters" do
    assert param_errors("set_mode", %{}) == ["params: expected exactly one of mode, standard_mode"]

    assert param_errors("set_home", %{"lat" => 1, "lon" => 2}) == [
             "params: expected all or none of lat, lon, altitude_msl"
           ]

    here = %{@takeoff | "type" => "set_home", "params" => %{"here" => true}}
    assert {:ok, %{params: %{here: true}}} = Command.parse(here, @now)
  end

  test "lists are bounded and their items checked" do
    assert [text] = param_errors("rc_override", %{"channels" => [1500, 9000]})
    assert text == "params.channels[1]: expected an integer from 0 to 2200 (µs), got 9000"
    assert [text] = param_errors("rc_override", %{"channels" => List.duplicate(1500, 19)})
    assert text =~ "got \"more than 18 items\""
    assert [_text] = param_errors("rc_override", %{"channels" => []})
  end

  test "times are ISO 8601 or unix seconds, and bounded" do
    parse = &Command.parse(Map.merge(@takeoff, &1), @now)
    iso = DateTime.to_iso8601(DateTime.from_unix!(@now + 5_000_000, :microsecond))
    assert {:ok, %{deadline: deadline}} = parse.(%{"deadline" => iso})
    assert deadline == @now + 5_000_000
    assert {:ok, %{deadline: ^deadline}} = parse.(%{"deadline" => @now / 1.0e6 + 5})
    assert {:error, [%Error{key: "deadline"}]} = parse.(%{"deadline" => div(@now, 1000)})
    assert {:error, [%Error{key: "deadline"}]} = parse.(%{"deadline" => @now / 1.0e6 + 400})
    assert {:error, [%Error{key: "deadline"}]} = parse.(%{"deadline" => "soon"})
    assert {:error, [%Error{key: "issued_at"}]} = parse.(%{"issued_at" => @now / 1.0e6 + 6})
    assert {:error, [%Error{key: "issued_at"}]} = parse.(%{"issued_at" => @now / 1.0e6 - 601})
    # Too late is an answer, not an error.
    assert {:ok, late} = parse.(%{"deadline" => @now / 1.0e6 - 1})
    assert Command.expired?(late, @now)
  end

  test "the digest is that of what is commanded" do
    digest = fn more ->
      {:ok, command} = Command.parse(Map.merge(@takeoff, more), @now)
      Command.digest(command)
    end

    same = digest.(%{})
    assert same =~ ~r/\A[0-9a-f]{64}\z/
    assert digest.(%{"params" => %{"altitude" => 20.0}}) == same
    assert digest.(%{"id" => "b", "deadline" => @now / 1.0e6 + 7}) == same

    for more <- [
          %{"params" => %{"altitude" => 21}},
          %{"vehicle" => "V"},
          %{"source" => "x"},
          %{"type" => "arm", "params" => %{}}
        ] do
      assert digest.(more) != same
    end

    # Nor does it count by which gateway it came.
    {:ok, command} = Command.parse(Map.merge(@takeoff, %{"source" => "gateways"}), @now)
    sender = Command.sender(Command.passed_on(@takeoff["source"], "rest"))
    assert Command.digest(%{command | sender: sender}) == same
    long = String.duplicate("n", 64)
    by_long = Command.sender(Command.passed_on(long, "console"))
    assert Command.digest(%{command | sender: by_long}) == Command.digest(%{command | source: long})
    assert Command.digest(%{command | sender: "another"}) != same

    for text <- ["tablet 3", " by rest", "ann by REST", "ann by rest\n", nil],
        do: assert(Command.sender(text) == nil)

    # A ledger is read by later versions: this value must not change.
    assert same == "ced6f014e55ed3071d15227a7886b70a8fecbf5f2d699f3bb55e69fbaa7a9b0f"
  end

  test "every result has a meaning, and comes back from its name" do
    for {status, meaning, _maybe?} <- Result.table() do
      assert meaning != ""
      assert Result.status(Atom.to_string(status)) == {:ok, status}
      result = Result.new("a", status, "why", %{"retries" => 2})

      assert Result.plain(result) == %{
               "id" => "a",
               "result" => "#{status}",
               "reason" => "why",
               "retries" => 2
             }
    end

    assert Result.status("great") == :error
  end

  test "docs/commands.md is what the tables say (mix aerie.commands)" do
    page = File.read!(Path.expand("../../../../../docs/commands.md", __DIR__))
    assert page == Mix.Tasks.Aerie.Commands.page()
    for name <- Types.names(), do: assert(page =~ "| `#{name}` |")
  end

  test "docs/msp.md is what the tables say (mix aerie.msp)" do
    assert File.read!(Path.expand("../../../../../docs/msp.md", __DIR__)) == Mix.Tasks.Aerie.Msp.page()
  end

  test "the examples of docs/commands.md are commands" do
    page = File.read!(Path.expand("../../../../../docs/commands.md", __DIR__))
    {:ok, now, 0} = DateTime.from_iso8601("2026-11-22T09:00:00Z")
    examples = Regex.scan(~r/```json\n(.*?)```/s, page, capture: :all_but_first)
    assert examples != []

    for [example] <- examples do
      assert {:ok, %Command{}} = Command.parse(JSON.decode!(example), DateTime.to_unix(now, :microsecond))
    end
  end
end
