defmodule Aerie.Api.Rest.Operations.Clients.Add do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias MavRouter.Client

  # HTTP clients must not name devices or files of this machine.
  @url "^((udp|udpin|udpout|udpbcast|tcp|tcpin):|wss?://)[!-~]*$"
  @max 512

  @impl true
  def operation do
    %Operation{
      name: "client.add",
      meaning: "Adds an endpoint for clients.",
      transfer?: false,
      closed?: true,
      fields: [
        url(),
        id(),
        networks(),
        field(:access, {:enum, [:full, :read]}, "whether its clients may send", default: :full)
      ],
      answer: %{id: %{type: :string}, url: %{type: :string}},
      routes: [post("/api/clients", "Adds an endpoint for clients.", change: :add_client, status: 201)]
    }
  end

  # `MavRouter.Client.add/2` checks what it names.
  defp url do
    check = &if(is_binary(&1) and byte_size(&1) <= @max, do: {:ok, &1}, else: :error)
    schema = %{type: :string, maxLength: @max, pattern: @url, examples: ["udpin:0.0.0.0:14550"]}
    words = "a connection string such as udpout:192.168.1.20:14550"
    field(:url, {:term, check, words}, "the connection string", required: true, schema: schema)
  end

  defp id do
    schema = %{type: :string, pattern: "^[A-Za-z0-9_.-]{1,64}$"}

    field(:id, {:term, &{:ok, &1}, "a name"}, "its name; made from the connection string if left out",
      schema: schema
    )
  end

  # Left out means all networks; so would an empty list, which is more likely a mistake.
  defp networks do
    check = &if(match?([_ | _], &1), do: {:ok, &1}, else: :error)
    schema = %{type: :array, minItems: 1, maxItems: 16, items: token()}
    words = "a list of names"

    field(:networks, {:term, check, words}, "only vehicles of these networks; all if left out",
      default: [],
      schema: schema
    )
  end

  @impl true
  def run(%{url: url, id: id, networks: networks, access: access}, context) do
    role = if access == :read, do: :read_only, else: :full
    client = %{url: url, id: id, networks: networks, role: role, from: :remote}
    with {:ok, id} <- Client.add(context.gateway, client), do: {:ok, %{id: id, url: url}}
  end
end
