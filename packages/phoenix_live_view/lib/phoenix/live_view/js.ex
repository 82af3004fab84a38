defmodule Phoenix.LiveView.JS do
  @moduledoc """
  Commands that the browser runs by itself on an event. They are chained and used in any `phx-` binding:

      <button phx-click={JS.push("remove", value: %{id: 7})}>
  """

  alias __MODULE__

  defstruct ops: []

  @type t :: %JS{ops: [[term()]]}

  @doc "Sends an event. Option `:value`: a map."
  @spec push(String.t() | t(), keyword() | String.t()) :: t()
  def push(event_or_js, options_or_event \\ [])
  def push(event, options) when is_binary(event), do: push(%JS{}, event, options)
  def push(%JS{} = js, event), do: push(js, event, [])
  @spec push(t(), String.t(), keyword()) :: t()
  def push(%JS{} = js, event, []), do: put(js, "push", %{event: event})
  def push(%JS{} = js, event, value: %{} = value), do: put(js, "push", %{event: event, value: value})

  @doc "Attributes that the server no longer changes; names may end with `*`."
  @spec ignore_attributes(t(), String.t() | [String.t()]) :: t()
  def ignore_attributes(js \\ %JS{}, names), do: put(js, "ignore_attrs", %{attrs: List.wrap(names)})

  defp put(%JS{ops: ops}, kind, args), do: %JS{ops: ops ++ [[kind, args]]}
end

defimpl Phoenix.HTML.Safe, for: Phoenix.LiveView.JS do
  def to_iodata(%{ops: ops}), do: ops |> JSON.encode!() |> Phoenix.HTML.Escape.text()
end
