defmodule Aerie.System.TransferFacesTest do
  @moduledoc """
  Parameters, plans and files of simulated ArduPilot and PX4 over NATS and over REST through the whole gateway, and the examples of
  docs/transfers.md.
  """

  use Aerie.SystemCase, async: true

  @moduletag :tmp_dir
  @moduletag :capture_log
  @key {"main", 1}
  @chief "key-of-the-chief-0001"
  @wall "key-of-the-wall-00001"
  @page File.read!(Path.expand("../../docs/transfers.md", __DIR__))
  @waypoints """
  QGC WPL 110
  0\t1\t0\t16\t0\t0\t0\t0\t-35.363261\t149.165230\t584\t1
  1\t0\t3\t22\t0\t0\t0\t0\t-35.363261\t149.165230\t20\t1
  2\t0\t3\t16\t0\t0\t0\t0\t-35.362261\t149.165230\t20\t1
  3\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
  """

  defp start(context, policy \\ %{}) do
    folder = context.tmp_dir
    keys = private_file(folder, "keys", "chief #{@chief} role=admin\nwall #{@wall} role=viewer\n")
    nkey = Nkey.generate(:user)
    wall = Nkey.generate(:user)

    policy =
      Map.merge(
        %{
          "max_altitude" => 100,
          "sources" => [
            %{"name" => "chief", "nkey" => nkey.public, "role" => "admin"},
            %{"name" => "wall", "nkey" => wall.public, "role" => "viewer"}
          ]
        },
        policy
      )

    overrides = %{"policy" => policy, "api" => %{"keys_file" => keys}, "timeouts" => patient()}

    %{gateway: gateway} =
      start_gateway(folder, links: ["udpin:127.0.0.1:0"], stations: ["maintain"], overrides: overrides)

    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"

    options = [
      firmware: context[:firmware] || :ardupilot,
      files: Map.merge(%{"/notes.txt" => "as found", <<"/caf", 0xE9>> => "latin"}, context[:files] || %{}),
      logs: context[:logs] || [],
      ready_s: 1.0,
      link: link
    ]

    sim = start_supervised!({SimVehicle, options})

    eventually(
      fn ->
        match?(
          %{capabilities: bits, groups: %{home: %{data: %{alt_msl: _}}}} when bits != nil,
          Store.vehicle(gateway, @key)
        )
      end,
      "vehicle, capabilities and home are known"
    )

    await_listening(gateway)
    %{gateway: gateway, sim: sim, nkey: nkey, wall: wall, conn: nats_client(gateway)}
  end

  defp await_listening(gateway), do: Aerie.BridgeCase.await_listening(gateway, ["VID-001"])

  defp vehicle(c, method, path, body \\ nil, options \\ []),
    do: rest(c.gateway, method, "vehicles/VID-001/#{path}", body, Keyword.put_new(options, :key, @chief))

  defp nats(c, operation, body, options \\ []),
    do: nats_request(c.conn, "fleet.test.VID-001.#{operation}", body, Keyword.get(options, :key, c.nkey))

  for firmware <- [:ardupilot, :px4] do
    @tag firmware: firmware
    test "#{firmware} over REST", context do
      c = start(context)
      name = if unquote(firmware) == :px4, do: "MIS_TAKEOFF_ALT", else: "WPNAV_SPEED"

      assert {200, %{"count" => count, "params" => [%{"name" => _, "value" => _} | _]}} =
               vehicle(c, :get, "params")

      assert count > 150
      assert {200, file} = vehicle(c, :get, "params?format=param")
      assert file =~ ~r/^#{name},/m
      assert {200, %{"value" => old}} = vehicle(c, :get, "params/#{name}")

      assert {200, %{"result" => "completed", "id" => "s1"}} =
               vehicle(c, :put, "params/#{name}", %{"value" => old + 1, "id" => "s1"})

      assert {200, %{"result" => "completed", "state" => "done"}} = vehicle(c, :get, "commands/s1")

      assert {200, %{"result" => "completed", "set" => 1}} =
               vehicle(c, :put, "params", file, type: "text/plain")

      assert {200, %{"value" => ^old}} = vehicle(c, :get, "params/#{name}")

      assert {422, %{"errors" => [%{"key" => "line 1"}]}} =
               vehicle(c, :put, "params", "one two three", type: "text/plain")

      assert {422, %{"errors" => [%{"key" => "NO_SUCH"}]}} =
               vehicle(c, :put, "params", "NO_SUCH,1", type: "text/plain")

      for values <- [0, "x", [], nil, true] do
        assert {422, %{"error" => %{"message" => "values: expected an object" <> _}}} =
                 vehicle(c, :put, "params", %{"values" => values})
      end

      assert {403, _refused} = vehicle(c, :put, "params/#{name}", %{"value" => 1}, key: @wall)

      assert {200, %{"result" => "completed", "on_board" => "new"}} =
               vehicle(c, :put, "mission", @waypoints, type: "text/plain")

      assert {200, %{"kind" => "mission", "items" => _n, "plan" => %{"fileType" => "Plan"} = plan}} =
               vehicle(c, :get, "mission", nil, key: @wall)

      assert {200, "QGC WPL 110" <> _lines} = vehicle(c, :get, "mission?format=waypoints")
      assert {200, %{"result" => "completed"}} = vehicle(c, :put, "mission", %{"plan" => plan, "id" => "m2"})
      high = String.replace(@waypoints, "\t20\t1\n3", "\t150\t1\n3")

      assert {403, %{"rule" => "altitude", "result" => "denied"}} =
               vehicle(c, :put, "mission", high, type: "text/plain")

      assert {422, _refused} = vehicle(c, :put, "mission?format=plan", "{}")
      assert {422, _refused} = vehicle(c, :get, "fence?format=waypoints")

      # What is not understood, or has nothing of the kind, leaves what is aboard.
      for {kind, name} <- [
            {"fence?format=plan", "no-fence-key.plan"},
            {"fence?format=plan", "version-99.plan"},
            {"rally?format=plan", "no-fence-key.plan"},
            {"mission?format=plan", "no-fence-key.plan"},
            {"mission?format=plan", "mission-version-9.plan"},
            {"mission?format=waypoints", "header-only.waypoints"}
          ] do
        text = File.read!(Path.expand("../../apps/control/test/fixtures/others/#{name}", __DIR__))

        assert {422, %{"error" => %{"code" => _code}}} =
                 vehicle(c, :put, kind, text, type: "application/octet-stream")
      end

      assert {422, _refused} = vehicle(c, :put, "mission?force=perhaps", @waypoints, type: "text/plain")
      assert {200, %{"plan" => %{"mission" => %{"items" => [_, _, _]}}}} = vehicle(c, :get, "mission")
      assert {200, %{"result" => "completed", "removed" => "3 items"}} = vehicle(c, :delete, "mission")
      assert {200, %{"plan" => %{"mission" => %{"items" => []}}}} = vehicle(c, :get, "mission")
      assert {405, _refused} = vehicle(c, :delete, "params")

      assert {200, "as found"} = vehicle(c, :get, "files/notes.txt")
      assert {200, %{"entries" => entries}} = vehicle(c, :get, "files/?list")
      assert "caf\\xE9" in Enum.map(entries, & &1["name"])
      assert {200, "latin"} = vehicle(c, :get, "files/caf%5CxE9")
      assert %{"kind" => "file", "size" => 8} = Enum.find(entries, &(&1["name"] == "notes.txt"))

      assert {200, %{"result" => "completed"}} =
               vehicle(c, :put, "files/new.bin", <<0, 255>>, type: "application/octet-stream")

      assert {200, <<0, 255>>} = vehicle(c, :get, "files/new.bin")
      assert {200, %{"result" => "completed"}} = vehicle(c, :delete, "files/new.bin")
      assert {404, %{"error" => %{"code" => "not_found"}}} = vehicle(c, :get, "files/new.bin")
      assert {200, %{"logs" => []}} = vehicle(c, :get, "logs")
    end

    @tag firmware: firmware
    test "#{firmware} over NATS", context do
      c = start(context)
      name = if unquote(firmware) == :px4, do: "MIS_TAKEOFF_ALT", else: "WPNAV_SPEED"
      {:ok, _sid} = Gnat.sub(c.conn, self(), "fleet.test.VID-001.*.*.progress.*")

      assert %{"result" => "completed", "count" => count} =
               nats(c, "params.list", %{"id" => "l1"}, key: c.wall)

      assert count > 150
      assert_receive {:msg, %{topic: "fleet.test.VID-001.params.list.progress.l1", body: progress}}
      assert %{"id" => "l1", "phase" => "reading", "total" => _total} = JSON.decode!(progress)
      assert %{"result" => "completed", "value" => old} = nats(c, "params.get", %{"name" => name})
      set = %{"id" => "s1", "name" => name, "value" => old + 1}
      assert %{"result" => "completed", "name" => ^name} = nats(c, "params.set", set)

      assert %{"result" => "rejected", "errors" => [%{"key" => "id"}]} =
               nats(c, "params.set", Map.delete(set, "id"))

      assert %{"result" => "denied", "rule" => "role"} =
               nats(c, "params.set", %{set | "id" => "s2"}, key: c.wall)

      assert %{"rule" => "signature"} = nats(c, "params.list", %{}, key: nil)

      {:ok, plan} = Aerie.Control.Missions.import(@waypoints, :waypoints)
      plan = plan |> Protocols.Mission.File.QgcPlan.write() |> JSON.decode!()

      assert %{"result" => "completed", "on_board" => "new"} =
               nats(c, "mission.put", %{"id" => "m1", "plan" => plan})

      assert %{"result" => "completed", "plan" => %{"mission" => %{"items" => [_, _, _]}}} =
               nats(c, "mission.get", %{})

      for {id, change} <- [{"e1", %{"geofence" => plan["geoFence"]}}, {"e2", %{}}] do
        put = %{"id" => id, "kind" => "fence", "plan" => Map.merge(plan, change)}
        assert %{"result" => "rejected", "errors" => [%{"key" => "plan"}]} = nats(c, "mission.put", put)
      end

      assert %{"result" => "completed", "removed" => "3 items"} =
               nats(c, "mission.clear", %{"id" => "m2", "kind" => "mission"})

      assert %{"errors" => [%{"key" => "kind"}]} = nats(c, "mission.get", %{"kind" => "route"})
      assert %{"errors" => [%{"key" => "subject"}]} = nats(c, "mission.fly", %{})

      assert %{"data" => data} = nats(c, "files.read", %{"path" => "/notes.txt"})
      assert Base.decode64!(data) == "as found"
      write = %{"id" => "f1", "path" => "/n.txt", "data" => Base.encode64("new")}
      assert %{"result" => "completed"} = nats(c, "files.write", write)
      assert %{"crc32" => _crc} = nats(c, "files.crc", %{"path" => "/n.txt"})
      assert %{"result" => "completed"} = nats(c, "files.remove", %{"id" => "f2", "path" => "/n.txt"})
      assert %{"result" => "rejected", "rule" => "file"} = nats(c, "files.read", %{"path" => "/n.txt"})
      assert %{"entries" => [_ | _]} = nats(c, "files.list", %{"path" => "/"})
      assert %{"logs" => []} = nats(c, "logs.list", %{})
    end
  end

  @log for(n <- 0..60_000, into: <<>>, do: <<rem(n * 7, 251)>>)

  for firmware <- [:ardupilot, :px4] do
    @tag firmware: firmware, logs: ["short", @log]
    test "#{firmware}: a log over REST, whole, in parts, and none that is not there", context do
      c = start(context)
      assert {200, %{"logs" => [%{"size" => 5}, %{"id" => id, "time" => time}]}} = vehicle(c, :get, "logs")
      assert {200, headers, @log} = download(c, id)
      assert headers["content-length"] == "60001"
      assert {200, _headers, ""} = download(c, id, [], :head)
      etag = headers["etag"]

      assert {206, headers, rest} = download(c, id, [{"range", "bytes=50000-"}, {"if-range", etag}])
      assert rest == binary_part(@log, 50_000, 10_001)
      assert headers["content-range"] == "bytes 50000-60000/60001"

      # Of another log nothing is continued.
      assert {200, _headers, @log} = download(c, id, [{"range", "bytes=50000-"}, {"if-range", ~s("1-at-2")}])
      assert {416, _headers, _text} = download(c, id, [{"range", "bytes=60001-"}])
      assert {404, %{"rule" => "log"}} = vehicle(c, :get, "logs/#{id + 1}")
      assert {404, _error} = vehicle(c, :get, "logs/first")
      assert {200, _headers, "short"} = download(c, id - 1, [{"range", "bytes=nonsense"}])

      # By NATS, in pieces.
      log = %{"id" => id, "size" => 60_001, "time" => time}
      assert pieces(c, log, 0) == @log
      assert %{"data" => "", "next" => nil} = nats(c, "logs.read", %{"log" => log, "offset" => 70_000})
      other = %{log | "time" => time + 1}
      assert %{"result" => "rejected", "rule" => "log"} = nats(c, "logs.read", %{"log" => other})
      assert %{"errors" => [%{"key" => "log"}]} = nats(c, "logs.read", %{"log" => id})
      assert %{"errors" => [%{"key" => "bytes"}]} = nats(c, "logs.read", %{"log" => log, "bytes" => 0})
    end
  end

  @described ~s({"version": 1, "parameters": [{"name": "MIS_TAKEOFF_ALT", "units": "m", "shortDesc": "Take-off altitude"}]})
  @general ~s({"version": 1, "metadataTypes": [{"type": 1, "uri": "mftp:///params.json"}]})

  @tag firmware: :px4,
       files: %{"/params.json" => @described, "etc/extras/component_general.json.xz" => :general}
  test "descriptions of parameters over REST and NATS", context do
    packed = Path.join(context.tmp_dir, "general")
    File.write!(packed, @general)
    {general, 0} = System.cmd("xz", ["--stdout", packed])
    c = start(put_in(context.files["etc/extras/component_general.json.xz"], general))

    assert {200, %{"params" => [%{"name" => "MIS_TAKEOFF_ALT", "unit" => "m", "reboot_required" => false}]}} =
             vehicle(c, :get, "metadata/params", nil, key: @wall)

    assert %{"params" => [%{"short" => "Take-off altitude"}]} =
             nats(c, "params.metadata", %{"names" => ["MIS_TAKEOFF_ALT", "NO_SUCH"]})

    assert %{"errors" => [%{"key" => "names"}]} = nats(c, "params.metadata", %{"names" => 5})
  end

  @tag logs: [:binary.copy("x", 4_000_000)]
  test "a log download ends when it is cancelled or its client hangs up, and breaks off when the vehicle is gone",
       context do
    c = start(context)
    log = %{"id" => 1, "size" => 4_000_000, "time" => 1_795_000_001}
    {:ok, _sid} = Gnat.sub(c.conn, self(), "fleet.test.VID-001.logs.read.progress.r1")
    read = Task.async(fn -> nats(c, "logs.read", %{"id" => "r1", "log" => log, "bytes" => 700_000}) end)
    assert_receive {:msg, %{body: body}}
    assert %{"phase" => "reading", "total" => 700_000} = JSON.decode!(body)
    assert %{"result" => "accepted"} = nats(c, "cmd.cancel", %{"id" => "r1"})
    assert %{"result" => "cancelled"} = Task.await(read, Aerie.Patience.ms())

    socket = begun(c)
    :ok = :gen_tcp.close(socket)
    # Another one has its turn before four million bytes could have come.
    assert {200, _logs} = vehicle(c, :get, "logs")

    assert [] =
             :sys.get_state(Aerie.Base.Names.whereis(c.gateway, :transfers, @key), Aerie.Patience.ms()).core.order

    # A clock that falls back by a few seconds is not a reboot (R6).
    eventually(
      fn -> Store.vehicle(c.gateway, @key).time_boot_ms > 10_000 end,
      "the vehicle has been up for a while"
    )

    # So many pieces have to be asked for again that it cannot be complete yet.
    :ok = SimVehicle.fault(c.sim, :loss, 0.3)
    socket = begun(c)
    :ok = SimVehicle.reboot(c.sim)
    :ok = SimVehicle.fault(c.sim, :loss, 0.0)
    assert byte_size(rest_of(socket, "")) < 4_000_000
  end

  # A download of which the first bytes have come.
  defp begun(%{gateway: gateway}) do
    {:ok, socket} =
      :gen_tcp.connect({127, 0, 0, 1}, Aerie.Api.Endpoint.port(gateway), [:binary, active: false])

    :ok =
      :gen_tcp.send(socket, [
        "GET /api/vehicles/VID-001/logs/1 HTTP/1.1\r\nhost: localhost\r\nx-aerie-key: ",
        @chief,
        "\r\n\r\n"
      ])

    {:ok, "HTTP/1.1 200 OK" <> _more} = :gen_tcp.recv(socket, 0)
    socket
  end

  defp rest_of(socket, before) do
    case :gen_tcp.recv(socket, 0) do
      {:ok, bytes} -> rest_of(socket, before <> bytes)
      {:error, :closed} -> before
    end
  end

  defp pieces(_c, _log, nil), do: ""

  defp pieces(c, log, offset) do
    request = %{"log" => log, "offset" => offset, "bytes" => 25_000}
    %{"data" => data, "offset" => ^offset, "next" => next} = nats(c, "logs.read", request)
    Base.decode64!(data) <> pieces(c, log, next)
  end

  # A vehicle that a busy machine kept from answering is asked again.
  defp download(c, id, headers \\ [], method \\ :get, tries \\ 5) do
    case fetch(c, id, headers, method) do
      {504, _headers, _text} when tries > 1 -> download(c, id, headers, method, tries - 1)
      answer -> answer
    end
  end

  defp fetch(%{gateway: gateway}, id, headers, method) do
    url = ~c"http://127.0.0.1:#{Aerie.Api.Endpoint.port(gateway)}/api/vehicles/VID-001/logs/#{id}"

    headers =
      for {name, value} <- [{"x-aerie-key", @chief}, {"connection", "close"} | headers],
          do: {~c"#{name}", ~c"#{value}"}

    {:ok, {{_version, status, _reason}, headers, body}} =
      http(method, {url, headers}, timeout: :infinity)

    {status, Map.new(headers, fn {name, value} -> {"#{name}", "#{value}"} end), body}
  end

  test "the examples of docs/transfers.md do what it says", context do
    c = start(context, %{"unsigned" => "admin"})
    shown = for [line] <- Regex.scan(~r/^\{.*\}$/m, @page), do: JSON.decode!(line)

    [_all, path] =
      Regex.run(~r/"X-Aerie-Key: \$KEY" http:\/\/localhost:4000\/api\/vehicles\/VID-001\/(\S+)/, @page)

    assert {200, answer} = vehicle(c, :get, path)
    assert_shown(answer, Enum.at(shown, 0))

    [_all, body, path] =
      Regex.run(~r/-d '(.+)' http:\/\/localhost:4000\/api\/vehicles\/VID-001\/(\S+)/, @page)

    assert {200, answer} = vehicle(c, :put, path, body)
    assert_shown(answer, Enum.at(shown, 1))

    [_all, path] =
      Regex.run(~r/@survey.waypoints http:\/\/localhost:4000\/api\/vehicles\/VID-001\/(\S+)/, @page)

    assert {200, answer} = vehicle(c, :put, path, @waypoints, type: "text/plain")
    assert_shown(answer, Enum.at(shown, 2))

    [_all, operation, body] = Regex.run(~r/nats request fleet\.dev\.VID-001\.(\S+) '(.+)' --timeout/, @page)
    answer = nats(c, operation, JSON.decode!(body), key: nil)
    assert_shown(answer, Enum.at(shown, 3))

    [_all, code] = Regex.run(~r/```elixir\n(.+?)```/s, @page)

    {{:ok, [_ | _]}, binding} =
      code |> String.replace(":default", "gateway") |> Code.eval_string(gateway: c.gateway)

    assert %{status: :completed} = binding[:result]
  end

  # The same keys as the page shows, and the same end.
  defp assert_shown(answer, shown) do
    assert Map.keys(shown) -- Map.keys(answer) == []

    assert Map.take(answer, ["id", "result", "type", "name"]) ==
             Map.take(shown, ["id", "result", "type", "name"])
  end
end
