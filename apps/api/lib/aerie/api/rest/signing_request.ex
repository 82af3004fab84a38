defmodule Aerie.Api.Rest.SigningRequest do
  @moduledoc """
  Checks the body of `POST /api/vehicles/ID/signing`. Pure.

      {"action": "enrol", "key": "generate", "link": "usb"}

  `action` is `enrol`, `revoke` or `discard`; `key` of `enrol` is `configured` (default), `generate` or `previous`. A request
  cannot contain a key or name a file of this machine, and no answer contains a key (S9). See `Aerie.Vehicle.Enrolment.enrol/3`.
  """

  alias Aerie.Access.HTTP.{Error, Request}

  @known ["action", "key", "link", "component"]
  @actions %{"enrol" => :enrol, "revoke" => :revoke, "discard" => :discard}
  @keys %{"configured" => [], "generate" => [key: :generate], "previous" => [key: :previous]}

  @doc "The action and the options of `MavRouter.Signing`."
  @spec parse(map()) :: {:ok, :enrol | :revoke | :discard, keyword()} | {:error, Error.t()}
  def parse(object) do
    with :ok <- Request.known(object, @known),
         {:ok, action} <- one_of("action", object["action"], @actions),
         {:ok, key} <- one_of("key", Map.get(object, "key", "configured"), @keys),
         :ok <- only(key == [] or action == :enrol, "key belongs to the action enrol only"),
         {:ok, link} <- link(object["link"]),
         {:ok, component} <- component(object["component"]) do
      {:ok, action, key ++ link ++ component}
    end
  end

  defp one_of(name, value, values) do
    with :error <- Map.fetch(values, value),
         do: Error.invalid("#{name} must be one of #{Enum.join(Map.keys(values), ", ")}")
  end

  defp only(true, _words), do: :ok
  defp only(false, words), do: Error.invalid(words)

  defp link(nil), do: {:ok, []}
  defp link(link) when is_binary(link) and byte_size(link) <= 512, do: {:ok, [link: link]}
  defp link(_other), do: Error.invalid("link must be the id of a link")

  defp component(nil), do: {:ok, []}
  defp component(n) when is_integer(n) and n in 1..255, do: {:ok, [component: n]}
  defp component(_other), do: Error.invalid("component must be a number from 1 to 255")
end
