defmodule MavRouter.Endpoints.Owner.RuleKeys do
  @moduledoc "The keys that links and clients have in common: filters, rates, bandwidth (`MavRouter.Endpoints.Settings`
  reads them)."

  import Aerie.Base.Settings.Field, only: [field: 3, field: 4, section: 3]

  alias Aerie.Base.Settings.Field

  @doc "Their declarations."
  @spec fields() :: [Field.t()]
  def fields do
    [
      section(:filter_in, "What may come from it: by message name, system, component.", filter_fields()),
      section(
        :filter_out,
        "What may go to it; sources are the links and clients that it comes from.",
        filter_fields() ++ sources()
      ),
      field(
        :rate_limits,
        {:map, {:number, 0, 10_000}},
        "Messages by name, and how often a second each goes to it.",
        default: %{}
      ),
      field(
        :bytes_per_s,
        {:integer, 50, 1_000_000_000},
        """
        Bytes a second that may go to each of its peers; what is important goes first. A serial line's own if left out.
        """
      )
    ]
  end

  defp filter_fields do
    for {name, type} <- [
          messages: :string,
          systems: {:integer, 0, 4_294_967_295},
          components: {:integer, 0, 255}
        ],
        kind <- ["allow", "block"],
        do: field(:"#{kind}_#{name}", {:one_or_list, type}, "", default: [], filled: kind == "allow")
  end

  defp sources,
    do: [
      field(:allow_sources, {:one_or_list, :string}, "", default: [], filled: true),
      field(:block_sources, {:one_or_list, :string}, "", default: [])
    ]
end
