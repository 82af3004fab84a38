defmodule Aerie.Api.Rest.Operations.Links.Add do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias MavRouter.Link

  # How connection strings begin; what follows is in docs/hub.md and docs/clients.md.
  @url "^((udp|udpin|udpout|udpbcast|tcp|tcpin|serial|msp):|wss?://|/|tty|cu\\.|rfcomm|COM)[!-~]*$"
  @max 512

  @impl true
  def operation do
    summary = "Adds a link; it lives until it is removed, or the gateway ends."

    %Operation{
      name: "link.add",
      meaning: "Adds a link.",
      transfer?: false,
      closed?: true,
      fields: [
        url(),
        field(:id, :token, "its name; made from the connection string if left out"),
        field(:network, :token, "the network of its vehicles"),
        field(:group, :token, "links of one group lead to the same vehicles"),
        field(:label, {:text, 0, 256}, "a text for people"),
        field(:high_latency, :boolean, "a slow link that costs by the byte", default: false)
      ],
      answer: %{id: %{type: :string}, url: %{type: :string}},
      routes: [post("/api/links", summary, change: :add_link, status: 201)]
    }
  end

  # What it names exactly, `MavRouter.Link.start/2` checks. A recording is not replayed from here: that would name any
  # file of this machine.
  defp url do
    words = "a connection string such as udpin:0.0.0.0:14550 or /dev/ttyUSB0,57600"
    schema = %{type: :string, maxLength: @max, pattern: @url, examples: ["udpin:0.0.0.0:14550"]}
    field(:url, {:term, &read_url/1, words}, "the connection string", required: true, schema: schema)
  end

  defp read_url("replay:" <> _file),
    do: {:error, "another connection string: a recording is replayed from the command line only"}

  defp read_url(url) when is_binary(url) and byte_size(url) <= @max, do: {:ok, url}
  defp read_url(_other), do: :error

  @impl true
  def run(link, context) do
    with {:ok, id} <- Link.start(context.gateway, link), do: {:ok, %{id: id, url: link.url}}
  end
end
