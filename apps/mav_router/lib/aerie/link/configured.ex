defmodule Aerie.Link.Configured do
  @moduledoc "From a link as the configuration has it (`Aerie.Link.Settings`, `links`) to its `Aerie.Link.Spec`. Pure."

  alias Aerie.Link.Spec
  alias Aerie.Router.Settings

  @doc "The spec; `url` is required, the other keys may be left out. The error is a text."
  @spec spec(map()) :: {:ok, Spec.t()} | {:error, String.t()}
  def spec(%{url: url} = link) do
    with {:ok, router} <- Settings.owner_options(Map.new(link)),
         {:ok, spec} <-
           Spec.parse(url, id: link[:id], network: link[:network], options: options(link, router)) do
      {:ok, spec}
    else
      {:error, error} when is_exception(error) -> {:error, Exception.message(error)}
      {:error, words} -> {:error, words}
    end
  end

  defp options(link, router) do
    [
      label: link[:label],
      high_latency: link[:high_latency] || false,
      secure: link[:secure] || false,
      router: router
    ]
  end
end
