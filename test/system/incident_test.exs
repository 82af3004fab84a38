defmodule Aerie.System.IncidentTest do
  @moduledoc "`aerie incident`: a flight with a command and a refusal becomes one archive, from a running gateway and from its folders."

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  @moduletag :tmp_dir
  @root Path.expand("../..", __DIR__)
  @secret "a-secret-that-must-stay-inside"

  setup %{tmp_dir: folder} do
    [link, http] = [free_udp_port(), free_tcp_port()]

    config =
      config_file(folder,
        nats: %{mode: :off},
        sockets: %{enabled: false},
        websocket: %{enabled: false},
        http: %{port: http},
        links: [%{id: "radio", url: "udpin:127.0.0.1:#{link}"}],
        vehicles: [%{id: "eagle", system_id: 78}],
        recorder: %{vehicles: "always", links: "always", min_free_mb: 0},
        policy: %{max_altitude: 120},
        shadow: %{key: @secret}
      )

    %{config: config, folder: folder, link: link, http: http}
  end

  defp aerie(c, words) do
    {text, status} =
      System.cmd("sh", ["-c", ~s(exec "$0" "$@" </dev/null 2>&1), Path.join(@root, "bin/aerie") | words],
        env: [{"AERIE_SHELL_DIR", Path.join(c.folder, "shell")}, {"AERIE_CWD", c.folder} | environment()]
      )

    {String.replace(text, ~r/^==> .*\n/m, ""), status}
  end

  defp unpacked(archive, to) do
    {:ok, files} = :erl_tar.extract(archive, [:memory, :compressed])
    File.mkdir_p!(to)
    for {name, bytes} <- files, do: File.write!(Path.join(to, Path.basename(name)), bytes)
    Map.new(files, fn {name, bytes} -> {name |> to_string() |> Path.basename(), bytes} end)
  end

  defp lines(text), do: text |> String.split("\n", trim: true) |> Enum.map(&JSON.decode!/1)

  # With the session of the address that the gateway writes for its own user.
  defp downloaded(c, path) do
    address = c.folder |> Path.join("console/url") |> File.read!() |> String.trim() |> String.to_charlist()

    {:ok, {{_http, 303, _reason}, headers, _body}} =
      :httpc.request(:get, {address, []}, [autoredirect: false], [])

    {_name, cookie} = List.keyfind(headers, ~c"set-cookie", 0)
    [cookie | _attributes] = :string.split(cookie, ";")
    url = "http://127.0.0.1:#{c.http}#{path}"

    {:ok, {{_http, status, _reason}, _headers, body}} =
      :httpc.request(:get, {url, [{~c"cookie", cookie}]}, [autoredirect: false], body_format: :binary)

    {status, body}
  end

  test "flies, is commanded, is refused once; the archive has it all, twice the same, and no secret", c do
    port = open(["--config", c.config, "--quiet"])

    listens = fn ->
      match?(%{"links" => [%{"status" => open}]} when open in ["up", "idle"], api(c.http, "/api/links"))
    end

    eventually(listens, "the link is open", started_by())
    begun = DateTime.utc_now() |> DateTime.truncate(:second) |> DateTime.to_iso8601()

    start_supervised!(
      {SimVehicle,
       firmware: :px4,
       system: 78,
       ready_s: 1.0,
       link: "udpout:127.0.0.1:#{c.link}",
       script: [:ready, :arm, {:takeoff, 20}, {:wait, 300}]}
    )

    flies = fn -> get_in(api(c.http, "/api/vehicles/eagle"), ["groups", "mode", "data", "in_air"]) end
    eventually(flies, fn -> "it flies: #{inspect(api(c.http, "/api/vehicles/eagle"), limit: 300)}" end)

    assert {done, 0} = aerie(c, ["cmd", "eagle", "hold", "--yes"])
    assert done =~ ~r/completed|accepted/
    assert {refused, 1} = aerie(c, ["cmd", "eagle", "goto", "lat=47.4", "lon=8.5", "altitude=500", "--yes"])
    assert refused =~ "denied"

    assert {text, 0} = aerie(c, ["incident", "eagle", "--from", begun, "--output", "now.tar.gz"])
    archive = Path.join(c.folder, "now.tar.gz")
    assert text =~ ~r/reading main-eagle-.*\.tlog/ and text =~ archive
    assert {"600\n", 0} = System.cmd("stat", ["-c", "%a", archive])
    files = unpacked(archive, Path.join(c.folder, "now"))

    assert ~w(audit.jsonl commands.jsonl diagnosis.json events.jsonl flight.tlog gateway-events.jsonl index.html
              link-main-radio.tlog manifest.json shadow.json) == files |> Map.keys() |> Enum.sort()

    types = for event <- lines(files["events.jsonl"]), do: event["type"]
    assert ["armed", "takeoff"] -- types == []

    assert [hold, goto] = lines(files["commands.jsonl"])
    assert %{"type" => "hold", "decision" => "allow", "sent_at" => _, "done_at" => _} = hold
    assert hold["result"] in ["completed", "accepted"] and hold["source"] != nil

    assert %{
             "type" => "goto",
             "decision" => "deny",
             "rule" => "altitude",
             "result" => "denied",
             "reason" => why
           } = goto

    assert why =~ "500" and not is_map_key(goto, "sent_at")

    # Lines of the log, whose own hashes still fit.
    for line <- String.split(files["audit.jsonl"], "\n", trim: true),
        do: assert({:ok, _record} = Aerie.Control.Policy.Audit.Record.decode(line))

    assert %{"conditions" => conditions, "machine" => [_ | _]} = JSON.decode!(files["diagnosis.json"])
    assert is_list(conditions)
    assert %{"shadow" => %{"vehicle" => "eagle", "reported" => _}} = JSON.decode!(files["shadow.json"])

    manifest = JSON.decode!(files["manifest.json"])
    assert %{"gateway" => "running", "only_now" => ["shadow.json", "diagnosis.json"]} = manifest

    for %{"name" => name, "bytes" => bytes, "sha256" => hash} <- manifest["files"] do
      assert byte_size(files[name]) == bytes
      assert :sha256 |> :crypto.hash(files[name]) |> Base.encode16(case: :lower) == hash
    end

    assert files["index.html"] =~ "Altitude above home" and files["index.html"] =~ "goto"
    assert files["index.html"] =~ "rule altitude"

    # The replay of the copy prints the same events.
    flight = Path.join([c.folder, "now", "flight.tlog"])
    assert {text, 0} = aerie(c, ["replay", flight, "--config", c.config])
    printed = for "{" <> _ = line <- String.split(text, "\n"), do: [line, "\n"]
    assert IO.iodata_to_binary(printed) == files["events.jsonl"]

    # The console packs the same.
    at = &(&1 |> DateTime.from_iso8601() |> elem(1) |> DateTime.to_unix())
    span = "from=#{at.(begun)}&to=#{System.os_time(:second)}"
    assert {200, archive} = downloaded(c, "/download/incident?vehicle=eagle&" <> span)
    packed = Path.join(c.folder, "console.tar.gz")
    File.write!(packed, archive)
    packed = unpacked(packed, Path.join(c.folder, "console-packed"))
    assert Map.keys(packed) -- Map.keys(files) == []
    assert [%{"type" => "hold"}, %{"rule" => "altitude"}] = lines(packed["commands.jsonl"])
    for {name, bytes} <- packed, do: refute(String.contains?(bytes, @secret), name)
    assert {422, text} = downloaded(c, "/download/incident?vehicle=falcon&" <> span)
    assert text =~ "no vehicle that this gateway hears has the name falcon"

    # Nothing is replaced.
    assert {text, 2} = aerie(c, ["incident", "eagle", "--from", begun, "--output", "now.tar.gz"])
    assert text =~ "exists already"
    assert {text, 2} = aerie(c, ["incident", "eagle", "--from", begun, "--to", begun])
    assert text =~ "is not before"

    # After a kill, from the folders alone, and twice the same.
    ended = DateTime.utc_now() |> DateTime.truncate(:second) |> DateTime.to_iso8601()
    kill_9(c.config)
    await_exit(port)
    assert {text, 3} = aerie(c, ["incident", "eagle", "--from", begun])
    assert text =~ "--config FILE reads the folders"
    span = ["--config", c.config, "--from", begun, "--to", ended]

    [first, second] =
      for name <- ["a b", "second"] do
        assert {_text, 0} = aerie(c, ["incident", "eagle", "--output", name <> ".tar.gz" | span])
        unpacked(Path.join(c.folder, name <> ".tar.gz"), Path.join(c.folder, name))
      end

    assert Map.drop(first, ~w(manifest.json diagnosis.json shadow.json)) ==
             Map.drop(second, ~w(manifest.json diagnosis.json shadow.json))

    assert [%{"type" => "hold"}, %{"rule" => "altitude"}] = lines(first["commands.jsonl"])
    assert %{"gateway" => "stopped", "not_included" => [_ | _]} = JSON.decode!(first["manifest.json"])

    for {name, bytes} <- Map.merge(files, first), do: refute(String.contains?(bytes, @secret), name)
    # Its own folder is gone.
    assert Path.wildcard(Path.join(c.folder, "*.part")) == []
  end
end
