defmodule MavRouter.Link.Transport.Form do
  @moduledoc "A form of connection strings, such as `udpin:HOST:PORT`."

  alias Aerie.Base.Net.Address

  @enforce_keys [:prefix, :expected, :example]
  defstruct [:prefix, :expected, :example, help: [], options: [], passes_query: false]

  @typedoc """
  - `prefix`: how strings of this form begin; `""` takes whatever no other form does
  - `expected`, `example`: for error messages
  - `help`: strings of this form, each with what it does; none for a form that is only another spelling
  - `options`: names of its options, besides those of every string
  - `passes_query`: whether options that are not known belong to the other end (a URL) instead of being errors
  """
  @type t :: %__MODULE__{
          prefix: String.t(),
          expected: String.t(),
          example: String.t(),
          help: [{String.t(), String.t()}],
          options: [String.t()],
          passes_query: boolean
        }

  @doc "A form with an address: `PREFIX` and `HOST:PORT`, which the example shows; `help` says what it does, if it is listed."
  @spec address(String.t(), String.t(), String.t() | nil, String.t()) :: t
  def address(prefix, example, help, place \\ "HOST:PORT") do
    expected = prefix <> place
    help = if help, do: [{expected, help}], else: []
    %__MODULE__{prefix: prefix, expected: expected, example: prefix <> example, help: help}
  end

  @doc "Reads such an address; only a server may leave the host empty or ask for port 0."
  @spec parse_address(String.t(), boolean) ::
          {:ok, %{host: term, port: :inet.port_number()}} | {:error, String.t()}
  def parse_address(text, server?) do
    with {:ok, host, port} <- Address.parse(text, server?), do: {:ok, %{host: host, port: port}}
  end
end
