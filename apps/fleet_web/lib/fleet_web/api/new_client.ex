defmodule FleetWeb.API.NewClient do
  @moduledoc """
  Checks the body of `POST /api/clients`. Pure.

      {"url": "udpout:192.168.1.20:14550", "id": "field", "networks": ["main"], "access": "read"}

  Only `url` is required. See `Aerie.Client.add/3`. HTTP clients may not name devices or files of this machine.
  """

  alias Aerie.Link.Spec
  alias FleetWeb.API.Error

  @kinds [:udp_server, :udp_client, :tcp_server, :tcp_client]

  @known ["url", "id", "networks", "access"]
  @name ~r/\A[A-Za-z0-9_.-]{1,64}\z/
  @most_networks 16

  @doc "Returns the connection string and the options."
  @spec parse(map()) :: {:ok, String.t(), [Aerie.Client.option()]} | {:error, Error.t()}
  def parse(object) do
    with :ok <- known(Map.keys(object) -- @known),
         {:ok, url} <- url(object["url"]),
         {:ok, id} <- id(object["id"]),
         {:ok, networks} <- networks(object["networks"]),
         {:ok, access} <- access(object["access"]) do
      {:ok, url, id ++ networks ++ access}
    end
  end

  defp known([]), do: :ok

  defp known([key | _]),
    do:
      invalid("#{inspect(String.slice(key, 0, 64))} is an unknown key; known are #{Enum.join(@known, ", ")}")

  defp url(url) when is_binary(url) and byte_size(url) <= 512 do
    case Spec.parse(url) do
      {:ok, %Spec{kind: kind}} when kind in @kinds -> {:ok, url}
      {:ok, _other} -> invalid("url must be one of udpin, udpout, udpbcast, tcpin and tcp for a client")
      {:error, error} -> invalid(Exception.message(error))
    end
  end

  defp url(_other), do: invalid("url must be a connection string such as udpout:192.168.1.20:14550")

  defp id(nil), do: {:ok, []}

  defp id(id) do
    if is_binary(id) and id =~ @name,
      do: {:ok, [id: id]},
      else: invalid("id must be at most 64 letters, digits and - _ .")
  end

  defp networks(nil), do: {:ok, []}

  defp networks(names) do
    if is_list(names) and names != [] and length(names) <= @most_networks and
         Enum.all?(names, &(is_binary(&1) and &1 =~ @name)),
       do: {:ok, [networks: names]},
       else: invalid("networks must be a list of 1 to #{@most_networks} names")
  end

  defp access(nil), do: {:ok, []}
  defp access("full"), do: {:ok, []}
  defp access("read"), do: {:ok, [access: :read]}
  defp access(_other), do: invalid("access must be read or full")

  defp invalid(message), do: {:error, Error.new(:invalid, message)}
end
