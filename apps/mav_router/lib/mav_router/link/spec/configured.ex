defmodule MavRouter.Link.Spec.Configured do
  @moduledoc "From a link as the configuration has it (`MavRouter.Link.Settings`, `links`) to its `MavRouter.Link.Spec`. Pure."

  alias MavRouter.Link.Spec
  alias MavRouter.Endpoints.Owner.RuleKeys

  @doc "The spec; `url` is required, the other keys may be left out. The error is a text."
  @spec spec(map()) :: {:ok, Spec.t()} | {:error, String.t()}
  def spec(%{url: url} = link) do
    with [] <- contradictions(link),
         {:ok, router} <- RuleKeys.owner_options(Map.new(link)),
         {:ok, spec} <-
           Spec.parse(url, id: link[:id], network: link[:network], options: options(link, router)) do
      {:ok, spec}
    else
      {:error, error} when is_exception(error) -> {:error, Exception.message(error)}
      {:error, words} -> {:error, words}
      [{key, words} | _] -> {:error, "#{key}: #{words}"}
    end
  end

  @doc "The keys of which the connection string says something else, with words for that."
  @spec contradictions(map()) :: [{:id | :network | :secure | :gcs, String.t()}]
  def contradictions(%{url: url} = link) do
    for {key, said} <- Enum.sort(Spec.said(url)), link[key] != nil, link[key] != said do
      {key, "#{link[key]} contradicts #{key}=#{said} in the url"}
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
