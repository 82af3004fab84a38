defmodule Aerie.Console.UI.Meter do
  @moduledoc "A bar for a share: a battery, a queue, the quality of a link."
  use Phoenix.Component

  attr :value, :any, required: true, doc: "0..1, nil when it is not known"
  attr :label, :string, required: true, doc: "what it measures, for screen readers"
  attr :text, :string, default: nil, doc: "the value in words; per cent unless given"
  attr :kind, :string, default: nil, doc: "`ok`, `warn`, `bad`"
  attr :class, :string, default: nil

  @doc "A meter with its value in words."
  def meter(assigns) do
    ~H"""
    <span class={["meter", @kind, @class]}>
      <span :if={@value != nil} class="meter-bar" role="meter" aria-label={@label} aria-valuemin="0" aria-valuemax="100" aria-valuenow={per_cent(@value)}>
        <svg viewBox="0 0 100 1" preserveAspectRatio="none" aria-hidden="true"><rect width={per_cent(@value)} height="1" /></svg>
      </span>
      <span class="meter-text">{@text || label(@value)}</span>
    </span>
    """
  end

  defp label(nil), do: "–"
  defp label(value), do: "#{per_cent(value)} %"
  defp per_cent(value), do: value |> max(0) |> min(1) |> Kernel.*(100) |> round()
end
