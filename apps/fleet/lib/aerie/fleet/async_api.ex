defmodule Aerie.Fleet.AsyncAPI do
  @moduledoc """
  `docs/asyncapi.json`: the subjects and payloads of NATS as AsyncAPI 3.0, made from the tables of state groups, events, commands, transfers and
  desired fields. `mix aerie.asyncapi` writes it. Pure.

  The gateway is the application that it describes: it sends state, and receives commands. Payloads of the gateway may get further keys in
  later versions, so their schemas are open; those of requests are closed, because a gateway refuses what it does not know.
  """

  alias Aerie.Base.Json
  alias Aerie.Fleet.AsyncAPI.{Channels, Schemas}

  @doc "The description."
  @spec document() :: map()
  def document do
    channels = Channels.all()

    %{
      asyncapi: "3.0.0",
      info: %{
        title: "Aerie",
        version: :fleet |> Application.spec(:vsn) |> to_string(),
        description:
          "What a gateway publishes to NATS and takes from it; docs/fleet.md, docs/commands.md, docs/shadow.md and docs/transfers.md " <>
            "explain it. In Elixir, REST and the console the same names mean the same."
      },
      defaultContentType: "application/json",
      servers: %{
        nats: %{
          host: "127.0.0.1:4222",
          protocol: :nats,
          description:
            "The server of nats.url, or the embedded one, whose address and login are in the file var/nats/url."
        }
      },
      channels: Map.new(channels, &{&1.id, Channels.channel(&1)}),
      operations: channels |> Enum.filter(& &1.action) |> Map.new(&{&1.id, Channels.operation(&1)}),
      components: %{
        messages: Map.new(messages(channels), &{&1.id, message(&1)}),
        parameters: Channels.parameters(),
        schemas: Schemas.all()
      }
    }
  end

  defp messages(channels), do: Enum.flat_map(channels, & &1.messages) |> Enum.uniq()

  defp message(%{id: id, schema: schema} = message) do
    %{
      name: id,
      title: message.title,
      contentType: Map.get(message, :content_type, "application/json"),
      payload: Json.Schema.ref(schema)
    }
    |> Map.merge(if headers = message[:headers], do: %{headers: Json.Schema.ref(headers)}, else: %{})
  end

  @doc "The text of `docs/asyncapi.json`: the same bytes each time."
  @spec text() :: String.t()
  def text, do: Json.Schema.pretty(document(), 2)
end
