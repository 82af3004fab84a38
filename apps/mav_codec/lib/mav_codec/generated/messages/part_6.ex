defmodule MavCodec.Generated.Messages.Part6 do
  use MavCodec.Definition.Shard, messages: {6, 8}
end
