defmodule Aerie.System.PageCommandsTest do
  @moduledoc "What README and docs/ tell a reader to type: here curl's part, literally, and that nothing is left which nobody runs."
  use Aerie.SystemCase, async: true

  alias Aerie.Pages

  @moduletag :tmp_dir
  @moduletag :capture_log
  @root Path.expand("../..", __DIR__)
  @key "key-of-the-reader-0001"
  @plan Protocols.Mission.File.QgcPlan.write(%Protocols.Mission.Plan{})
  @waypoints """
  QGC WPL 110
  0\t1\t0\t16\t0\t0\t0\t0\t47.397742\t8.545594\t488\t1
  1\t0\t3\t22\t0\t0\t0\t0\t47.397742\t8.545594\t20\t1
  2\t0\t3\t16\t0\t0\t0\t0\t47.398200\t8.546100\t30\t1
  """

  test "every command is run by a test or walked by a guide, or its page says why not" do
    walked = @root |> Path.join("test/guides/*.sh") |> Path.wildcard() |> Enum.map_join("\n", &File.read!/1)

    left =
      for page <- Pages.all(),
          block <- Pages.blocks(page),
          not marked?(block),
          command <- block.commands,
          not curl?(command),
          # The command line tool of NATS is not in Debian. The tests that read these pages send the same by a client.
          not String.starts_with?(command, "nats "),
          not String.contains?(walked, command) and not String.contains?(walked, quoted(command)),
          do: "#{page}: #{command}"

    assert left == []
  end

  # As a script has it between double quotes.
  defp quoted(command), do: String.replace(command, ["\\", "$", "\""], &("\\" <> &1))

  # A mark that says nothing, or that names a file that is gone, is an error.
  defp marked?(%{mark: nil}), do: false
  defp marked?(%{mark: "not run: " <> _reason}), do: true

  defp marked?(%{mark: "run by " <> file, page: page}),
    do:
      File.exists?(Path.join(@root, file)) or
        flunk("#{page} says that #{file} runs its commands: there is none")

  defp marked?(%{mark: mark, page: page}),
    do: flunk("#{page}: <!-- #{mark} --> is neither run by nor not run")

  defp curl?(command), do: String.starts_with?(command, "curl ")

  @tag :curl
  test "curl does what the pages say", %{tmp_dir: folder} do
    gateway = gateway(folder)
    curl = configure_curl(gateway, folder)
    blocks = for page <- Pages.all(), %{mark: nil} = block <- Pages.blocks(page), do: block
    commands = for block <- blocks, command <- block.commands, curl?(command), do: {block.page, command}
    # The README's own is walked with the whole guide.
    commands = Enum.reject(commands, &match?({"README.md", _}, &1))
    assert length(commands) > 15

    Enum.reduce(commands, %{}, fn {page, command}, before ->
      # A recording's name is known when it has been saved.
      typed = Regex.replace(~r/main-VID-001-near_miss-\S+\.tlog/, command, Map.get(before, :name, "none"))
      {answer, status} = curl.(typed)
      # Such a connection stays open until curl has had enough.
      upgraded? = command =~ "Upgrade: websocket" and answer =~ ~r/^101$/m
      assert status == 0 or upgraded?, "#{page}: #{command}\n#{answer}"

      case Regex.run(~r/"name":"([^"]+\.tlog)"/, answer) do
        [_all, name] -> Map.put(before, :name, name)
        nil -> before
      end
    end)
  end

  # With the names that the pages use.
  defp gateway(folder) do
    keys = private_file(folder, "keys", "reader #{@key} role=admin\n")
    config = Path.join(folder, "gateway.yaml")
    File.write!(config, "policy: {unsigned: admin}\n")
    File.write!(Path.join(folder, "survey.plan"), @plan)
    File.write!(Path.join(folder, "survey.waypoints"), @waypoints)

    overrides = %{
      "api" => %{"keys_file" => keys},
      "timeouts" => patient(),
      "clients" => [%{"id" => "tablet", "url" => "udpout:127.0.0.1:#{free_udp_port()}"}],
      "vehicles" =>
        for({id, n} <- [{"VID-001", 1}, {"sim-001", 2}, {"sim-002", 3}], do: %{"id" => id, "system_id" => n})
    }

    %{gateway: gateway} =
      start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: overrides, config_file: config)

    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"

    for n <- 1..3 do
      options = [link: link, system: n, camera: if(n == 1, do: 100)] ++ fast_vehicle(:ardupilot)
      SimVehicle.await(start_supervised!({SimVehicle, options}, id: n), & &1.ready)
      await_standing(gateway, {"main", n})
    end

    gateway
  end

  # The ports of this gateway in the place of the usual ones, and an error for an answer that is one.
  defp configure_curl(gateway, folder) do
    ports = [{4000, Aerie.Api.Endpoint.port(gateway)}, {8765, Aerie.Api.WebSocket.port(gateway)}]

    connect =
      for host <- ["127.0.0.1", "localhost"],
          {usual, port} <- ports,
          do: "connect-to = #{host}:#{usual}:127.0.0.1:#{port}"

    lines = connect ++ ["fail-with-body", "silent", "show-error", ~s(noproxy = "*")]
    File.write!(Path.join(folder, ".curlrc"), Enum.join(lines, "\n") <> "\n")
    environment = [{"CURL_HOME", folder}, {"HOME", folder}, {"KEY", @key}, {"AERIE_API_KEY", @key}]

    fn command ->
      System.cmd("bash", ["-c", command], cd: folder, env: environment, stderr_to_stdout: true)
    end
  end
end
