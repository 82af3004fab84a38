defmodule Aerie.SecurityDocTest do
  @moduledoc "docs/security.md says what listens by default as the configuration has it."
  use ExUnit.Case, async: true

  alias Aerie.Config

  @page File.read!(Path.expand("../../../../docs/security.md", __DIR__))

  test "everything but the port for vehicles listens on loopback, at the ports of the page" do
    config = Config.default()

    for {address, port} <- [
          {config.http.address, config.http.port},
          {config.websocket.address, config.websocket.port},
          {"127.0.0.1", config.nats.port}
        ] do
      assert address == "127.0.0.1"
      assert @page =~ "`#{address}:#{port}`"
    end

    assert [%{url: "udpin:" <> listens}] = config.links
    assert @page =~ "UDP `#{listens}`"
    assert config.clients == :default and @page =~ "`127.0.0.1:5790`"
  end

  test "its links lead somewhere" do
    docs = Path.expand("../../../../docs", __DIR__)

    for [_all, file] <- Regex.scan(~r/\]\(([^)#]+)/, @page),
        do: assert(File.exists?(Path.join(docs, file)), file)
  end
end
