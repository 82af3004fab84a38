defmodule Aerie.CLI.CheckTest do
  use ExUnit.Case, async: true

  alias Aerie.CLI
  alias Aerie.Control.Policy.Audit.Log

  @moduletag :tmp_dir

  @fence ~s({"type": "Point", "coordinates": [8.0, 47.0]})

  defp check(dir, words), do: CLI.Start.call(words, %{"AERIE_CWD" => dir})

  defp policy(dir, command, more \\ []),
    do: check(dir, ["--check-policy", "gateway.yaml", "--command", command] ++ more)

  setup %{tmp_dir: dir} do
    File.write!(
      Path.join(dir, "gateway.yaml"),
      "policy:\n  max_altitude: 120\n  geofence_file: #{dir}/fence.json\n"
    )

    File.write!(Path.join(dir, "fence.json"), """
    {"type": "Feature", "properties": {"name": "field", "radius": 1000}, "geometry": #{@fence}}
    """)

    :ok
  end

  test "decision, rule and reason, with the status of a check", %{tmp_dir: dir} do
    there = ~s({"position": {"lat": 47.0, "lon": 8.0, "alt_rel": 10}})
    goto = &~s({"type": "goto", "params": {"lat": #{&1}, "lon": 8.0, "altitude": #{&2}}})
    assert policy(dir, goto.(47.001, 50), ["--vehicle", there]) == {:finish, "allow\n"}

    assert policy(dir, goto.(47.001, 150), ["--vehicle", there]) ==
             {:denied, "deny altitude: the target is 150 m above home; at most 120 m is allowed\n"}

    assert {:denied, "deny geofence: the target 47.020000, 8.000000 is 12" <> _} =
             policy(dir, goto.(47.02, 50), ["--vehicle", there])

    assert policy(dir, goto.(47.001, 50)) ==
             {:denied, "deny geofence: a fence applies to goto, and the vehicle's position is not known\n"}

    assert {:denied, "deny role: " <> _} = policy(dir, ~s({"type": "arm"}), ~w(--role viewer))
    assert {:denied, "deny role: " <> _} = policy(dir, ~s({"type": "force_disarm"}), ~w(--role admin))
    assert {:finish, _} = policy(dir, ~s({"type": "force_disarm"}), ~w(--permission force_disarm))

    # From files, as a script has them.
    File.write!(Path.join(dir, "command.json"), goto.(47.001, 50))
    File.write!(Path.join(dir, "vehicle.json"), there)
    assert policy(dir, "command.json", ["--vehicle", "vehicle.json"]) == {:finish, "allow\n"}
  end

  test "what cannot be judged says why", %{tmp_dir: dir} do
    assert {:fail, text} = policy(dir, ~s({"type": "goto", "params": {"lat": 95}}))
    assert text =~ "error: --command: params.lat: expected a number from -90 to 90"
    assert {:fail, "error: --command: expected JSON, got something else\n"} = policy(dir, "{")
    assert {:fail, text} = policy(dir, "absent.json")
    assert text =~ "--command: absent.json: no such file or directory"
    assert {:fail, text} = policy(dir, ~s({"type": "arm"}), ["--vehicle", ~s({"colour": 1})])
    assert text =~ "--vehicle: colour: expected one of"
    File.write!(Path.join(dir, "fence.json"), @fence)
    assert {:fail, text} = policy(dir, ~s({"type": "arm"}))
    assert text =~ "policy.geofence_file: expected a fence, got: #{dir}/fence.json: "
    File.write!(Path.join(dir, "gateway.yaml"), "policy: {max_altitud: 120}\n")
    assert {:fail, text} = policy(dir, ~s({"type": "arm"}))
    assert text =~ ~s(did you mean "max_altitude"?)
  end

  test "an audit log that is intact, and one that is not", %{tmp_dir: dir} do
    audit = Path.join(dir, "audit")
    {:ok, log} = Log.open(audit, 1_000_000, 0)
    {:ok, log} = Log.append(log, %{"type" => "decision", "decision" => "deny"}, 0)
    Log.close(log)
    assert {:finish, "intact: 2 records, 1 to 2, hash " <> _} = check(dir, ["--check-audit", "audit"])
    [file] = Path.wildcard(Path.join(audit, "*.jsonl"))
    File.write!(file, file |> File.read!() |> String.replace("deny", "allow"))
    assert {:denied, "NOT intact: " <> text} = check(dir, ["--check-audit", "audit"])
    assert text =~ "line 2: was changed"
    assert {:fail, "error: " <> _} = check(dir, ["--check-audit", "absent"])
  end
end
