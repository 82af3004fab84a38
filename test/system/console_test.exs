defmodule Aerie.System.ConsoleTest do
  @moduledoc "The console as a newcomer meets it: `bin/run`, the address that it prints, and a browser."

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  import Aerie.ConsoleCase, only: [await_line: 2]

  @moduletag :tmp_dir
  @moduletag :chromium

  @scripts Path.expand("../browser", __DIR__)

  setup %{tmp_dir: folder} do
    mavlink = %{local_addr: "127.0.0.1:#{free_udp_port()}"}
    config = config_file(folder, http: %{port: free_tcp_port()}, sockets: %{enabled: false}, mavlink: mavlink)

    %{config: config, audit: Path.join(folder, "audit"), url: Path.join(folder, "console/url")}
  end

  # The address that signs in, once the gateway runs.
  defp start(config, url, more) do
    port = open(["--config", config, "--quiet" | more])
    output = await_output(port, "", ["sign_in_with_the_address_in="])
    # A log must not have what signs in.
    refute output =~ "token="
    eventually(fn -> File.exists?(url) end, "the address is written")
    url |> File.read!() |> String.trim()
  end

  @tag Aerie.Browser.long()
  test "a newcomer opens the printed address, sees three vehicles fly, and flies one", context do
    address = start(context.config, context.url, ["--sim", "3", "--speed", "3"])
    {output, status} = Aerie.Browser.run(Path.join(@scripts, "newcomer.mjs"), [address])
    assert status == 0, output
  end

  test "a gateway that is killed and started again: the page recovers, and nothing is sent again", context do
    address = start(context.config, context.url, ["--sim", "1"])
    script = Aerie.Browser.open(Path.join(@scripts, "killed.mjs"), [address])
    await_line(script, "held")
    kill_9(context.config)
    Port.command(script, "killed\n")
    await_line(script, "lost")
    File.rm!(context.url)
    start(context.config, context.url, ["--sim", "1"])
    Port.command(script, "back\n")
    await_line(script, "ok")
    assert decisions(context.audit) == ["hold"]
  end

  # What the audit log has of commands, of both lives of the gateway.
  defp decisions(audit) do
    for path <- audit |> Path.join("*.jsonl") |> Path.wildcard() |> Enum.sort(),
        line <- File.stream!(path),
        %{"type" => "decision", "command" => command} <- [JSON.decode!(line)],
        do: command
  end
end
