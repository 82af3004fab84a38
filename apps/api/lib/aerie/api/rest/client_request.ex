defmodule Aerie.Api.Rest.ClientRequest do
  @moduledoc """
  Reads the body of `POST /api/clients`. Pure.

      {"url": "udpout:192.168.1.20:14550", "id": "field", "networks": ["main"], "access": "read"}

  Only `url` is required. `MavRouter.Client.add/2` checks the values; HTTP clients must not name devices or files of
  this machine.
  """

  alias Aerie.Access.HTTP.{Error, Request}

  @known ["url", "id", "networks", "access"]
  @max_url 512

  @doc "Returns the client for `MavRouter.Client.add/2`."
  @spec parse(map()) :: {:ok, map()} | {:error, Error.t()}
  def parse(object) do
    with :ok <- Request.known(object, @known),
         {:ok, url} <- url(object["url"]),
         {:ok, networks} <- networks(object["networks"]),
         {:ok, role} <- role(object["access"]) do
      {:ok, %{url: url, id: object["id"], networks: networks, role: role, from: :remote}}
    end
  end

  defp url(url) when is_binary(url) and byte_size(url) <= @max_url, do: {:ok, url}
  defp url(_other), do: Error.invalid("url must be a connection string such as udpout:192.168.1.20:14550")

  # Left out means all networks; so would an empty list, which is more likely a mistake.
  defp networks(nil), do: {:ok, []}
  defp networks([_ | _] = names), do: {:ok, names}
  defp networks(_other), do: Error.invalid("networks must be a list of names")

  defp role(access) when access in [nil, "full"], do: {:ok, :full}
  defp role("read"), do: {:ok, :read_only}
  defp role(_other), do: Error.invalid("access must be read or full")
end
