defmodule Aerie.CLI.CheckTest do
  @moduledoc "`aerie policy try --command` and `aerie audit check`."
  use ExUnit.Case, async: true

  alias Aerie.CLI
  alias Aerie.Control.Policy.Audit.Log

  @moduletag :tmp_dir

  @fence ~s({"type": "Point", "coordinates": [8.0, 47.0]})

  defp policy(dir, command, more \\ []),
    do: CLI.call(["policy", "try", "gateway.yaml", "--command", command] ++ more, dir)

  setup %{tmp_dir: dir} do
    File.write!(
      Path.join(dir, "gateway.yaml"),
      "policy:\n  max_altitude: 120\n  geofence_file: #{dir}/fence.json\n" <>
        "api: {keys_file: \"#{dir}/keys\"}\n"
    )

    File.write!(Path.join(dir, "keys"), "ending 0123456789abcdef0 role=operator permissions=force_disarm\n")
    File.chmod!(Path.join(dir, "keys"), 0o600)

    File.write!(Path.join(dir, "fence.json"), """
    {"type": "Feature", "properties": {"name": "field", "radius": 1000}, "geometry": #{@fence}}
    """)

    :ok
  end

  test "decision, rule and reason, with the status of a check", %{tmp_dir: dir} do
    there = ~s({"position": {"lat": 47.0, "lon": 8.0, "alt_rel": 10}})
    goto = &~s({"type": "goto", "params": {"lat": #{&1}, "lon": 8.0, "altitude": #{&2}}})
    assert policy(dir, goto.(47.001, 50), ["--vehicle", there]) == {0, "allow\n"}

    assert policy(dir, goto.(47.001, 150), ["--vehicle", there]) ==
             {1, "deny altitude: the target is 150 m above home; at most 120 m is allowed\n"}

    assert {1, "deny geofence: the target 47.020000, 8.000000 is 12" <> _} =
             policy(dir, goto.(47.02, 50), ["--vehicle", there])

    assert policy(dir, goto.(47.001, 50)) ==
             {1, "deny geofence: a fence applies to goto, and the vehicle's position is not known\n"}

    assert {1, "deny role: " <> _} = policy(dir, ~s({"type": "arm"}), ~w(--as viewer))
    assert {1, "deny role: " <> _} = policy(dir, ~s({"type": "force_disarm"}), ~w(--as admin))
    assert {0, "allow\n"} = policy(dir, ~s({"type": "force_disarm"}), ~w(--as ending))

    # From files, as a script has them.
    File.write!(Path.join(dir, "command.json"), goto.(47.001, 50))
    File.write!(Path.join(dir, "vehicle.json"), there)
    assert policy(dir, "command.json", ["--vehicle", "vehicle.json"]) == {0, "allow\n"}
  end

  test "what cannot be judged says why", %{tmp_dir: dir} do
    assert {:error, text} = policy(dir, ~s({"type": "goto", "params": {"lat": 95}}))
    assert text =~ "--command: params.lat: expected a number from -90 to 90"
    assert {:error, "--command: expected JSON, got something else"} = policy(dir, "{")
    assert {:error, text} = policy(dir, "absent.json")
    assert text =~ "--command: absent.json: no such file or directory"
    assert {:error, text} = policy(dir, ~s({"type": "arm"}), ["--vehicle", ~s({"colour": 1})])
    assert text =~ "--vehicle: colour: expected one of"
    File.write!(Path.join(dir, "fence.json"), @fence)
    assert {:error, text} = policy(dir, ~s({"type": "arm"}))
    assert text =~ "policy.geofence_file: expected a fence, got: #{dir}/fence.json: "
    File.write!(Path.join(dir, "gateway.yaml"), "policy: {max_altitud: 120}\n")
    assert {:error, text} = policy(dir, ~s({"type": "arm"}))
    assert text =~ ~s(did you mean "max_altitude"?)
  end

  test "options that would do nothing are refused", %{tmp_dir: dir} do
    assert policy(dir, ~s({"type": "arm"}), ~w(--recordings var)) ==
             {:error, "--command is judged without recordings: leave out --recordings"}

    assert CLI.call(~w(policy try gateway.yaml --vehicle {}), dir) ==
             {:error, "--vehicle needs --command JSON"}
  end

  test "an audit log that is intact, and one that is not", %{tmp_dir: dir} do
    audit = Path.join(dir, "audit")
    {:ok, log} = Log.open(audit, 1_000_000, 0)
    {:ok, log} = Log.append(log, %{"type" => "decision", "decision" => "deny"}, 0)
    Log.close(log)
    assert {0, text} = CLI.call(["audit", "check", "audit"], dir)
    assert to_string(text) =~ ~r/\Aintact: 2 records, 1 to 2, hash \w+\n\z/
    File.write!(Path.join(dir, "gateway.yaml"), "policy: {audit: {dir: \"#{audit}\"}}\n")
    assert CLI.call(["audit", "check", "--config", "gateway.yaml"], dir) == {0, text}

    [file] = Path.wildcard(Path.join(audit, "*.jsonl"))
    File.write!(file, file |> File.read!() |> String.replace("deny", "allow"))
    assert {1, text} = CLI.call(["audit", "check", "audit"], dir)
    assert to_string(text) =~ ~r/\ANOT intact: .*line 2: was changed/s
    assert {:error, _why} = CLI.call(["audit", "check", "absent"], dir)
  end
end
