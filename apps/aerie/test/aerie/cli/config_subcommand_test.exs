defmodule Aerie.CLI.ConfigSubcommandTest do
  use ExUnit.Case, async: true

  alias Aerie.CLI

  @moduletag :tmp_dir

  test "config show has what somebody set and where it comes from, and no secret", %{tmp_dir: folder} do
    File.write!(Path.join(folder, "g.yaml"), """
    nats: {mode: url, url: "nats://hub:4222", user: ops, password: hunter22}
    environment: field
    """)

    assert {0, text} = CLI.call(["config", "show", "g.yaml"], folder)
    text = IO.iodata_to_binary(text)
    assert text =~ ~r/environment +field +.*g.yaml/
    assert text =~ "nats.password" and text =~ "hidden"
    refute text =~ "hunter22"
    refute text =~ "recorder.dir"

    assert {0, text} = CLI.call(["config", "show", "g.yaml", "--all"], folder)
    assert IO.iodata_to_binary(text) =~ ~r/recorder.dir +var\/recordings +default/
  end

  test "config check reports every error, with key and what was expected", %{tmp_dir: folder} do
    File.write!(Path.join(folder, "g.yaml"), "http: {prot: 1}\nmavlink: {system_id: -3}\n")
    assert {1, text} = CLI.call(["config", "check", "g.yaml"], folder)
    text = IO.iodata_to_binary(text)
    assert text =~ "http.prot" and text =~ "mavlink.system_id"
    assert {1, text} = CLI.call(["config", "check", "none.yaml"], folder)
    assert IO.iodata_to_binary(text) =~ "none.yaml"
  end

  test "config check shows where the zones of the fence are", %{tmp_dir: folder} do
    ring = [[8.0, 47.0], [8.1, 47.0], [8.1, 47.1], [8.0, 47.1]]
    zone = %{"type" => "Polygon", "coordinates" => [ring]}
    properties = %{"name" => "field", "max_altitude" => 100}
    fence = %{"type" => "Feature", "properties" => properties, "geometry" => zone}
    File.write!(Path.join(folder, "fence.json"), JSON.encode!(fence))

    File.write!(Path.join(folder, "g.yaml"), """
    policy: {geofence_file: "#{folder}/fence.json", audit: {dir: "#{folder}/audit"}}
    nats: {mode: "off"}
    console: {enabled: false}
    commands: {ledger: {dir: "#{folder}/ledger"}}
    """)

    assert {0, text} = CLI.call(["config", "check", "g.yaml"], folder)
    text = IO.iodata_to_binary(text)

    assert text =~
             ~r/fence: inclusion zone "field" around 47\.0[45]\d+, 8\.0[45]\d+ \(latitude, longitude\), up to 100 m above home/

    assert text =~ "a gateway can start with it"
  end
end
