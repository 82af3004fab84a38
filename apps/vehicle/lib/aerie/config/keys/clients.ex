defmodule Aerie.Config.Keys.Clients do
  @moduledoc "Where ground stations and other programs come in."

  import Aerie.Config.Field, only: [field: 3, field: 4]

  alias Aerie.Config.{Field, Types}
  alias Aerie.Config.Keys.Rules

  @doc "The key `clients`."
  @spec field() :: Field.t()
  def field do
    field(
      :clients,
      {:list, {:section, fields()}},
      """
      Where ground stations and other programs come in: udpin, udpout, udpbcast:ADDRESS:PORT, tcpin, tcp, or a DEVICE.
      Left out: TCP on 127.0.0.1, port 5790 or the next free one. [] for none. A ground station that calls a link (UDP
      14550) is taken for a client by itself, for as long as no autopilot is heard from there.
      """,
      default: nil,
      example:
        ~S([{id: field-laptop, url: "udpout:192.168.1.20:14550", rate_limits: {ATTITUDE: 4}, filter_out: {block_messages: [RAW_IMU]}}])
    )
  end

  defp fields do
    [
      field(:id, Types.token(), "Name of the client; its connection string if left out."),
      field(:url, Types.link_url(), "Connection string.", required: true),
      field(
        :networks,
        {:one_or_list, Types.token()},
        "Networks that it sees, all if left out. Where two have the same system id, it sees the one that is named first.",
        default: []
      ),
      field(
        :id_offsets,
        {:map, {:integer, 0, 238}},
        """
        System ids of a network are shown to this client with so much added, so that it sees vehicles of the same id on
        several networks at once. Frames are changed for that; not for networks with signing keys.
        """,
        default: %{},
        example: "{north: 10, south: 20}"
      ),
      field(:label, :string, "Words for people."),
      field(:enabled, :boolean, "Open it.", default: true),
      field(:role, {:enum, [:full, :read_only]}, "read_only: nothing that it says goes to anyone.",
        default: :full
      ),
      field(:sniffer, :boolean, "It gets what is addressed to others, too.", default: false),
      field(
        :sign,
        :boolean,
        "What it sends unsigned is believed, and signed for vehicles that ask for it (UNSAFE unless only you reach it).",
        default: false
      ),
      field(
        :coalesce,
        :boolean,
        "Frames may share a datagram when many wait; false for a peer that reads only the first of each (mavp2p).",
        default: true
      ),
      field(:queue_frames, {:integer, 1, 100_000}, "Frames that wait for one that does not keep up.",
        default: 1000
      ),
      field(:queue_kb, {:integer, 1, 65_536}, "… and kilobytes.", default: 256),
      field(
        :transfer_kb,
        {:integer, 64, 1_048_576},
        "Kilobytes of what it asked for (logs, files, parameters, missions) that wait beside that, for each of its peers.",
        default: 8192
      )
    ] ++ Rules.fields()
  end
end
