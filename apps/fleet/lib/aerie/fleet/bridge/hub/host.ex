defmodule Aerie.Fleet.Bridge.Hub.Host do
  @moduledoc "The name or address of one of the hub's servers, as a person types it. Pure."

  alias Aerie.Base.Settings.Types

  @doc "A server's name or address as certificates and addresses have it: lower case, without brackets and without the dot of the root."
  @spec parse(String.t()) :: {:ok, String.t()} | {:error, String.t()}
  def parse(text) do
    bare = text |> String.replace(~r/\A\[(.*)\]\z/, "\\1") |> String.trim_trailing(".")

    case :inet.parse_strict_address(String.to_charlist(bare)) do
      {:ok, address} ->
        if bare =~ "%",
          do: wrong(text, "without a zone (%), because vehicles have other ones"),
          else: {:ok, address |> :inet.ntoa() |> List.to_string()}

      {:error, _name} ->
        name(text, Types.parse_host(bare))
    end
  end

  defp name(text, {:ok, name}) do
    labels = String.split(name, ".")

    cond do
      Enum.any?(labels, &(byte_size(&1) > 63 or &1 =~ ~r/\A-|-\z/)) ->
        wrong(text, "a part has at most 63 letters, digits, - and _")

      List.last(labels) =~ ~r/\A\d+\z/ ->
        wrong(text, "an IPv4 address has four numbers up to 255")

      true ->
        {:ok, name}
    end
  end

  defp name(text, :error) do
    cond do
      text =~ "*" -> wrong(text, "each server has a name of its own, not a wildcard")
      text =~ "/" or text =~ ~r/:\d+\z/ -> wrong(text, "without a scheme, a port or a path")
      text =~ ~r/[^\x00-\x7F]/u -> wrong(text, "written in ASCII, as xn--…")
      true -> wrong(text, nil)
    end
  end

  defp wrong(text, why),
    do:
      {:error,
       "--host #{inspect(text)}: expected a name such as hub.example.org or an IP address#{why && ": " <> why}"}
end
