defmodule Gnat.ServerInfo do
  @moduledoc """
  The INFO message of the server as a map with the atom keys below. Unknown fields are left out, so that nothing from a server
  becomes a new atom.
  """

  @fields ~w(auth_required client_id client_ip cluster cluster_dynamic connect_urls domain git_commit go headers host ip
             jetstream ldm max_payload nonce port proto server_id server_name tls_available tls_required tls_verify
             version ws_connect_urls xkey api_lvl)a

  @by_name Map.new(@fields, &{Atom.to_string(&1), &1})

  # The fields that the client uses; the others are only shown.
  @integers ~w(max_payload proto)a
  @booleans ~w(auth_required headers tls_available tls_required)a

  @doc "Reads the JSON text after `INFO `."
  @spec decode(binary()) :: {:ok, Gnat.server_info()} | {:error, String.t()}
  def decode(json) do
    case JSON.decode(json) do
      {:ok, %{} = object} ->
        for({name, value} <- object, key = @by_name[name], into: %{}, do: {key, value}) |> check()

      _other ->
        {:error, "INFO is not a JSON object"}
    end
  end

  defp check(info) do
    bad =
      Enum.find(@integers, &(not is_integer(Map.get(info, &1, 0)))) ||
        Enum.find(@booleans, &(not is_boolean(Map.get(info, &1, false))))

    if bad, do: {:error, "INFO has a bad #{bad}: #{inspect(info[bad])}"}, else: {:ok, info}
  end
end
