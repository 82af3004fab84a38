defmodule Aerie.Base.SettingsTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Settings
  alias Aerie.Base.Settings.{Field, Schema, Types}

  defmodule Pump do
    use Aerie.Base.Settings

    part :identity, MavRouter.Identity.Settings

    section "pump", "A pump."
    setting :pause_ms, {:number, 0, 10}, "Pause.", key: "pause_s", default: 0.5, times: 1000
    setting :mode, {:enum, [:slow, :fast]}, "Mode.", default: :slow
    setting :clock, :string, "For tests.", internal: true, default: System
    setting :hose, {:section, hose()}, "Its hose."

    section "limits"
    setting :max_pumps, {:integer, 1, 9}, "Pumps.", default: 2

    defp hose,
      do: [
        field(:metres, {:integer, 1, 100}, "Length.", default: 10),
        field(:leaks, :boolean, "", default: true)
      ]

    @impl Settings
    def derive(settings), do: %{settings | mode: if(settings.max_pumps > 5, do: :fast, else: settings.mode)}
  end

  test "what a configuration does not say has its default, in the part's units; other keys do not matter" do
    assert %Pump{pause_ms: 500, mode: :slow, clock: System, max_pumps: 2} = Pump.from(%{http: %{port: 1}})

    assert %Pump{pause_ms: 1500, hose: %{metres: 3, leaks: true}} =
             Pump.from(%{pump: %{pause_s: 1.5, hose: %{metres: 3}}})

    assert %Pump{hose: %{metres: 10, leaks: false}} =
             Pump.from(%{pump: %{hose: %{leaks: false, metres: nil}}})

    assert %Pump{mode: :fast} = Pump.from(%{limits: %{max_pumps: 6}})
    assert %Pump{clock: Fake} = Pump.from(%{pump: %{clock: Fake}})

    assert %Pump{identity: %MavRouter.Identity.Settings{network: "south", system_id: 237}} =
             Pump.from(%{network: "south"})

    assert %Pump{identity: %{system_id: 1}} = Pump.from(%{vehicle_id: "A"})
  end

  test "a part's own map is checked: types, ranges, unknown keys, those of its parts too" do
    assert {:ok, pump} = Pump.new(%{pump: %{mode: :fast}, mavlink: %{"component_id" => 7}})
    assert %{mode: :fast, pause_ms: 500, identity: %{component_id: 7}} = pump
    assert Pump.new(%{}) == {:ok, Pump.from(%{})}

    assert {:error, [%{path: ["pump", "mod"], hint: "did you mean \"mode\"?"}]} =
             Pump.new(%{pump: %{mod: "fast"}})

    assert {:error, [%{path: ["pump", "clock"]}]} = Pump.new(%{pump: %{clock: "x"}})
    assert {:error, [range]} = Pump.new(%{limits: %{max_pumps: 10}})
    assert %{path: ["limits", "max_pumps"], expected: "an integer from 1 to 9", got: "10"} = range
    assert {:error, [%{expected: "one of slow, fast"}]} = Pump.new(%{pump: %{mode: "stuck"}})
  end

  test "parts make one schema: sections in the order of their first keys, with their meanings" do
    fields = Settings.fields([Pump, MavRouter.Recorder.Settings], %{"limits" => "Bounds."})

    assert [%Field{key: :pump, doc: "A pump."}, %Field{key: :limits, doc: "Bounds."}, %Field{key: :recorder}] =
             fields

    paths = for {path, _field} <- Schema.leaves(fields), do: Enum.join(path, ".")
    assert "pump.hose.metres" in paths and "recorder.ring.max_kb" in paths
    refute "pump.clock" in paths
  end

  test "text is read as its key's type; lists and maps by the reader that came with it" do
    fields = [
      Field.field(:ports, {:list, {:integer, 1, 9}}, "p", default: []),
      Field.field(:m, {:map, :boolean}, "m")
    ]

    json = fn text -> {:ok, JSON.decode!(text)} end

    assert {%{ports: [1, 2]}, []} =
             Schema.validate(fields, %{"ports" => {:text, "1, 2", fn _text -> {:ok, "1, 2"} end}})

    assert {%{ports: [3]}, []} = Schema.validate(fields, %{"ports" => {:text, "[3]", json}})
    assert {%{m: %{"a" => true}}, []} = Schema.validate(fields, %{"m" => {:text, ~s({"a": true}), json}})
    broken = fn _text -> {:error, %{expected: "valid YAML", got: "a tab"}} end

    assert {_, [%{path: ["m"], expected: "valid YAML", got: "a tab"}]} =
             Schema.validate(fields, %{"m" => {:text, "x", broken}})
  end

  test "limits of numbers are part of the type" do
    fields = [Field.field(:n, {:integer, 1, 3}, "n"), Field.field(:x, {:number, 0, 1}, "x")]
    assert {%{n: 3, x: 1.0}, []} = Schema.validate(fields, %{"n" => 3, "x" => 1})
    assert {_, [%{path: ["n"]}, %{path: ["x"]}]} = Schema.validate(fields, %{"n" => 4, "x" => 1.1})
    assert {_, [%{path: ["n"]}, %{path: ["x"]}]} = Schema.validate(fields, %{"n" => 1.5, "x" => "1"})
    assert {_, [_, _]} = Schema.validate(fields, %{"n" => {:text, "1x"}, "x" => {:text, "1e999"}})
    assert {%{n: 2, x: 0.5}, []} = Schema.validate(fields, %{"n" => {:text, "2"}, "x" => {:text, "0.5"}})
  end

  test "addresses" do
    assert Types.parse_listen(":14550") == {:ok, {"0.0.0.0", 14_550}}
    assert Types.parse_listen("127.0.0.1:0") == {:ok, {"127.0.0.1", 0}}
    assert Types.parse_listen("[::1]:1") == {:ok, {"::1", 1}}
    for bad <- ["", ":", ":65536", "host", "::1:1", "a b:1"], do: assert(Types.parse_listen(bad) == :error)
  end

  test "URLs of NATS servers" do
    for good <- ["nats://localhost", "nats://u:p@h:1", "tls://[::1]:4222"],
        do: assert({:ok, ^good} = Types.parse_nats_url(good))

    for bad <- ["localhost", "nats://", "http://h", "nats://h:99999", "nats://h/x?y"],
        do: assert(Types.parse_nats_url(bad) == :error)
  end
end
